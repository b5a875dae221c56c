"""Verdicts of every test on data whose truth is known: right where it is clear, open where it is not."""

import re
from collections import Counter
from functools import partial

import numpy as np
import pydantic
import pytest

from bojax.claims.samples import MIN_RUNS
from bojax.config.component import registry
from bojax.report import statistics
from bojax.report.findings import Undecidable, decide, evaluate
from bojax.report.manifest import Latency
from tests.report.synthetic import in_memory

ORDER = {"kind": "order", "column": "value"}
RATIO = {"kind": "ratio", "column": "value", "label": "a", "to": "b", "tolerance": 0.25, "expected": 1.2}
SIMILAR = {"kind": "similar", "column": "value", "labels": ["a", "b", "c"], "step": 4, "margin": 0.1}
ALIKE = {"kind": "similar", "column": "value", "labels": ["a", "b", "c"], "factor": 1.2}
YES, NO, OPEN = "reproduced", "not reproduced", "inconclusive"


def normal(means, runs=200, noise=1.0, seed=0, **more):
    """Values with these means; runs of equal index share most of what they owe to chance."""
    random = np.random.default_rng(seed)
    shared = random.normal(size=runs)
    values = {name: mean + shared + noise * random.normal(size=runs) for name, mean in means.items()}
    return in_memory({name: {"value": each} for name, each in values.items()}, **more)


def flags(runs, first, second):
    """Two columns of booleans: so many runs hold in the first alone, so many in the second alone."""
    a, b = np.zeros((2, runs), dtype=bool)
    a[:first] = True
    b[first : first + second] = True
    return in_memory({"a": {"value": a}, "b": {"value": b}})


def curves(gap, spread=10.0, runs=200, seed=0):
    """Three curves that differ by a gap at step 4 and by a spread at step 10."""
    random = np.random.default_rng(seed)
    steps = {name: np.cumsum(random.normal(size=(runs, 10)), axis=1) for name in "abc"}
    steps["b"][:, 3] += gap
    for place, name in enumerate("abc"):
        steps[name][:, 9] += place * spread / 2
    return in_memory({name: {"value": np.zeros(runs)} for name in "abc"}, steps)


def judge(results, test):
    return decide(results, registry["test"][test["kind"]].model_validate(test))


class TestLatency:
    """Times with known ranges: of `b` they overlap with those of `c`."""

    TIMES = {"a": (0.1, 0.09, 0.12), "b": (0.2, 0.15, 0.3), "c": (0.25, 0.24, 0.4), "d": (0.9, 0.8, 1.0)}

    @pytest.fixture
    def results(self):
        results = normal(dict.fromkeys(self.TIMES, 0.0))
        seconds = {str(point.index): list(self.TIMES[point.name]) for point in results.points}
        results.__dict__["latency"] = Latency(seconds=seconds)
        return results

    def test_an_order_holds_where_no_ranges_overlap(self, results):
        for labels, verdict in (("abd", YES), ("abc", OPEN), ("bad", NO), ("cba", NO)):
            finding = judge(results, {"kind": "latency", "labels": [*labels]})
            assert finding.verdict == verdict, labels
            assert finding.ours.split(" < ")[0].startswith("a ") == ("a" in labels)
            first = finding.comparisons[0].interval
            (quick, quick_low, quick_high), (slow, slow_low, slow_high) = (
                self.TIMES[each] for each in labels[:2]
            )
            assert (first.estimate, first.low, first.high) == pytest.approx(
                (slow / quick, slow_low / quick_high, slow_high / quick_low)
            )

    def test_a_bound_has_to_exceed_every_time(self, results):
        for below, verdict in ((0.31, YES), (0.2, OPEN), (0.14, NO)):
            finding = judge(results, {"kind": "latency", "labels": ["b"], "below": below})
            assert (finding.verdict, finding.ours) == (verdict, 0.2)

    def test_times_are_alike_where_all_ratios_to_the_first_are_within_a_factor(self, results):
        for labels, factor, verdict in (("cbd", 7.0, YES), ("dcb", 5.0, OPEN), ("bad", 1.2, NO)):
            finding = judge(results, {"kind": "latency", "labels": [*labels], "factor": factor})
            assert finding.verdict == verdict
            assert [each.of for each in finding.comparisons] == [f"{x} / {labels[0]}" for x in labels[1:]]

    def test_without_a_measurement_nothing_is_said(self):
        with pytest.raises(Undecidable, match="not measured: run `bojax bench latency "):
            judge(normal({"a": 0.0}), {"kind": "latency", "labels": ["a"], "below": 1.0})


class TestOrder:
    def test_the_smaller_may_come_first(self):
        results = normal({"a": 0.0, "b": 1.0, "c": 2.0})
        finding = judge(results, {**ORDER, "less": ["a", "b", "c"]})
        assert finding.verdict == YES
        assert [comparison.of for comparison in finding.comparisons] == ["b - a", "c - b"]
        assert re.fullmatch(r"a \S+ < b \S+ < c \S+", str(finding.ours))
        assert judge(results, {**ORDER, "less": ["a", "c", "b"]}).verdict == NO
        up, down = (
            judge(results, {**ORDER, **way}) for way in ({"less": ["a", "b"]}, {"greater": ["b", "a"]})
        )
        assert up.comparisons == down.comparisons and up.verdict == down.verdict

    def test_several_names_may_share_a_place(self):
        results = normal({"a": 0.0, "b": 1.0, "c": 1.0, "d": 2.0})
        finding = judge(results, {**ORDER, "less": ["a", ["b", "c"], "d"]})
        assert finding.verdict == YES
        assert [c.of for c in finding.comparisons] == ["b - a", "c - a", "d - b", "d - c"]
        assert judge(results, {**ORDER, "less": ["b", ["a", "c"]]}).verdict == NO
        assert judge(results, {**ORDER, "greater": ["d", ["a", "b", "c"]]}).verdict == YES

    def test_of_several_variants_the_best_stands_for_a_label_in_either_direction(self):
        swept = {name: {"label": "one" if name == "a" else "other"} for name in "abc"}
        results = normal({"a": 0.0, "b": 1.0, "c": 2.0}, swept=swept)
        assert judge(results, {**ORDER, "less": ["one", "other"]}).chosen == {"other": "b"}
        assert judge(results, {**ORDER, "greater": ["other", "one"]}).chosen == {"other": "c"}

    def test_a_margin_allows_for_a_small_lag(self):
        for lag, verdict in ((0.0, YES), (0.5, OPEN), (1.0, NO)):
            results = normal({"a": -lag, "b": 0.0}, runs=100)
            finding = judge(results, {**ORDER, "greater": ["a", "b"], "margin": 0.5})
            assert finding.verdict == verdict
            assert finding.decisive.of == "a - b + 0.5"
            assert finding.decisive.interval.estimate == pytest.approx(
                0.5 + np.diff(results.paired(results.points[::-1], "value")).mean()
            )

    def test_a_margin_can_be_a_share_of_a_lead(self):
        # 10% of the lead of b over c is 1: a has to be above 9.
        for mean, verdict in ((9.9, YES), (9.0, OPEN), (8.0, NO)):
            for sign, way in ((1, "greater"), (-1, "less")):
                results = normal({"a": sign * mean, "b": sign * 10.0, "c": 0.0})
                finding = judge(results, {**ORDER, way: ["a", "b"], "margin": 0.1, "baseline": "c"})
                assert finding.verdict == verdict
        # Twice the lead of b over c is 20.
        for mean, verdict in ((21.0, YES), (20.0, OPEN), (19.0, NO)):
            results = normal({"a": mean, "b": 10.0, "c": 0.0})
            finding = judge(results, {**ORDER, "greater": ["a", "b"], "margin": -1.0, "baseline": "c"})
            assert finding.verdict == verdict
            assert finding.decisive.of == "a - b - 1 (b - c)"

    def test_a_number_stands_for_missing_ones(self):
        results = in_memory({"a": {"value": np.ones(40)}, "b": {"value": np.full(40, np.nan)}})
        test = {**ORDER, "less": ["a", "b"]}
        with pytest.raises(Undecidable, match="40 runs of b without a finite value"):
            judge(results, test)
        for limit, verdict in ((5.0, YES), (0.5, NO)):
            finding = judge(results, {**test, "censored_at": limit})
            assert finding.verdict == verdict
            assert f"value ({limit:g} where missing)" in finding.method and f"b {limit:g}" in finding.ours

    def test_a_run_that_never_reached_its_goal_is_not_sooner_than_others(self):
        times = {"a": np.arange(30.0, 70.0), "b": np.full(40, np.nan)}
        results = in_memory({name: {"steps_to_goal": column} for name, column in times.items()})
        test = {"kind": "order", "column": "steps_to_goal"}
        for limit, verdict in ((12.0, OPEN), (50.0, NO), (200.0, NO)):
            finding = judge(results, {**test, "less": ["b", "a"], "censored_at": limit})
            assert finding.verdict == verdict
            assert finding.decisive.interval.estimate == np.minimum(times["a"], limit).mean() - limit

    def test_shares_are_compared_run_by_run_as_by_bonett_and_price(self):
        finding = judge(flags(200, 30, 10), {**ORDER, "greater": ["a", "b"]})
        interval = finding.decisive.interval
        assert finding.verdict == YES and interval.estimate == pytest.approx(0.1)
        assert judge(flags(200, 10, 30), {**ORDER, "greater": ["a", "b"]}).verdict == NO
        first, second = 31 / 202, 11 / 202
        half = 1.96 * np.sqrt((first + second - (first - second) ** 2) / 202)
        expected = first - second - half, first - second + half
        assert (interval.low, interval.high) == pytest.approx(expected, abs=0.004)

    def test_bounds_that_hold_for_any_share_decide_nothing(self):
        results, one = flags(200, 30, 10), {"column": "value", "label": "a"}
        for test, reason in (
            ({**one, "kind": "mean", "above": -1.0}, "a share; allowed: thresholds from 0 to 1"),
            ({**one, "kind": "mean", "above": 0.0, "below": 1.5}, "thresholds from 0 to 1"),
            ({**ORDER, "greater": ["b", "a"], "margin": 1.0}, "a margin of 1 holds for any two"),
            (
                {**ORDER, "kind": "similar", "labels": ["a", "b"], "margin": 2.0},
                "a margin of 2 holds for any two shares",
            ),
        ):
            with pytest.raises(Undecidable, match=reason):
                judge(results, test)

    def test_few_runs_that_differ_decide_nothing_about_shares(self):
        for few in (0, 1, 4):  # four of four is 0.06 one-sided in the exact test of McNemar
            finding = judge(flags(200, few, 0), {**ORDER, "greater": ["a", "b"]})
            assert finding.verdict == OPEN
            assert finding.decisive.interval.low <= 0 < finding.decisive.interval.high


class TestRatio:
    def test_it_is_the_interval_that_has_to_lie_within_the_tolerance(self):
        # The bounds are 12 / 1.25 and 12 * 1.25 = 15.
        for mean, verdict in ((12.0, YES), (15.0, OPEN), (20.0, NO)):
            finding = judge(normal({"a": mean, "b": 10.0}), RATIO)
            assert finding.verdict == verdict
            assert finding.ours == pytest.approx(mean / 10, abs=0.05)

    def test_the_opposite_order_is_never_the_expected_ratio(self):
        for mean, expected, verdict in ((9.5, 1.05, NO), (10.5, 1.05, YES), (10.5, 0.95, NO)):
            results = normal({"a": mean, "b": 10.0}, noise=0.1)
            assert judge(results, {**RATIO, "expected": expected}).verdict == verdict

    def test_the_interval_is_paired(self):
        # What both share cancels: the ratio is known better than either mean.
        results = normal({"a": 12.0, "b": 10.0}, noise=0.01)
        interval = judge(results, RATIO).decisive.interval
        mean = statistics.mean_interval(results.paired(results.points[:1], "value")[:, 0])
        assert interval.high - interval.low < 0.3 * (mean.high - mean.low) / 10

    def test_the_direction_is_said_and_wide_intervals_decide_nothing(self):
        for expected, told in ((1.3, "above 1, as claimed"), (0.8, "above 1, contrary to the claim")):
            assert told in judge(normal({"a": 12.0, "b": 10.0}), {**RATIO, "expected": expected}).method
        assert judge(normal({"a": 12.0, "b": 10.0}, runs=20, noise=10.0), RATIO).verdict == OPEN

    def test_means_around_zero_have_no_ratio(self):
        for means, test in (
            ({"a": 1.0, "b": 0.1}, RATIO),
            ({"a": -5.0, "b": 10.0}, RATIO),
            ({"a": 1.0, "b": 0.0, "c": 1.0}, ALIKE),
        ):
            with pytest.raises(Undecidable, match="not clearly positive"):
                judge(normal(means, runs=50), test)


def columns(means, runs=200, seed=0):
    """Columns of a point with these means."""
    random = np.random.default_rng(seed)
    shared = random.normal(size=runs)
    named = zip(("first", "second", "third"), means, strict=True)
    return in_memory({"a": {name: mean + shared + random.normal(size=runs) for name, mean in named}})


class TestMeans:
    """Several means against one threshold, as those of the four corners of a map."""

    TEST = {"kind": "mean", "label": "a", "column": "first", "also": ["second", "third"], "above": 0.0}

    def test_all_have_to_exceed_it_and_one_that_does_not_decides(self):
        # With noise larger than the means, the least of three is below 0 in most runs: another statistic.
        for last, verdict in ((0.5, YES), (0.0, OPEN), (-1.0, NO)):
            results = columns((0.5, 0.5, last), runs=400)
            assert np.min([results.runs[name] for name in ("first", "second", "third")], axis=0).mean() < -0.1
            finding = judge(results, self.TEST)
            assert finding.verdict == verdict
            assert [each.of for each in finding.comparisons] == ["first of a", "second of a", "third of a"]
            assert finding.decisive.of == ("third of a" if verdict != YES else finding.decisive.of)
            # The threshold moves with the means, and the other side has the other verdict.
            moved = {**self.TEST, "above": 5.0}
            assert judge(columns((5.5, 5.5, last + 5.0), runs=400), moved).verdict == verdict
        below = {key: value for key, value in self.TEST.items() if key != "above"} | {"below": 0.0}
        assert judge(columns((-1.0, -1.0, -1.0)), below).verdict == YES
        assert judge(columns((-1.0, -1.0, 1.0)), below).verdict == NO

    def test_shares_are_refused(self):
        results = in_memory({"a": {name: np.ones(40, dtype=bool) for name in ("first", "second", "third")}})
        with pytest.raises(Undecidable, match="Booleans"):
            judge(results, self.TEST)


def test_the_change_between_two_steps_is_compared():
    results = curves(5.0)  # `b` has 5 more at step 4, and as much more as `a` at no other step
    late = {**ORDER, "step": 4, "since": 3, "less": ["a", "b"]}
    assert judge(results, late).verdict == YES
    assert judge(results, {**late, "step": 6, "since": 5}).verdict == OPEN
    assert judge(results, {**late, "less": ["b", "a"]}).verdict == NO
    assert "value at step 4, less that at step 3" in judge(results, late).method


class TestSimilar:
    def test_differences_are_held_against_a_share_of_the_spread(self):
        for gap, verdict in ((0.0, YES), (1.0, OPEN), (3.0, NO)):
            finding = judge(curves(gap), {**SIMILAR, "spread_at": 10})
            assert finding.verdict == verdict
            assert [comparison.of for comparison in finding.comparisons] == ["a - b", "a - c", "b - c"]
        # Without a spread, the margin is in the unit of the column.
        assert judge(curves(0.0), {**SIMILAR, "margin": 1.0}).verdict == YES
        assert judge(curves(3.0), {**SIMILAR, "margin": 1.0}).verdict == NO
        # A spread of nothing but chance tells nothing, and so does any share of it.
        assert judge(curves(0.0, spread=0.0), {**SIMILAR, "spread_at": 10}).verdict == OPEN

    def test_with_a_factor_all_ratios_are_held_against_it(self):
        for c, verdict in ((10.5, YES), (12.0, OPEN), (13.0, NO)):
            finding = judge(normal({"a": 10.0, "b": 10.0, "c": c}), ALIKE)
            assert finding.verdict == verdict
            assert [comparison.of for comparison in finding.comparisons] == ["a / b", "a / c", "b / c"]
            # The order of the names decides nothing: a ratio of 1.2 is as far from 1 as its inverse.
            assert judge(normal({"a": c, "b": 10.0, "c": 10.0}), ALIKE).verdict == verdict

    def test_two_names_have_the_interval_of_their_ratio(self):
        results = normal({"a": 10.5, "b": 10.0})
        expected = judge(results, RATIO).decisive.interval
        found = judge(results, {**ALIKE, "labels": ["a", "b"]}).decisive.interval
        np.testing.assert_allclose(
            [found.estimate, found.low, found.high], [expected.estimate, expected.low, expected.high]
        )

    def test_a_step_that_no_run_reached_is_a_reason(self):
        with pytest.raises(Undecidable, match="the longest took 10"):
            judge(curves(0.0), {**SIMILAR, "step": 11})


def alike(runs, seed):
    """Two equal shares."""
    random = np.random.default_rng(seed)
    differing = random.binomial(runs, 0.1)
    return flags(runs, first := random.binomial(differing, 0.5), differing - first)


GREATER = {**ORDER, "greater": ["a", "b"]}
OF_A = {"label": "a", "column": "value"}
SHARE_OF_A = {"kind": "agrees", "share": 1.0, "runs": 20, **OF_A}


@pytest.mark.parametrize(
    ("make", "test", "confirmed", "refuted"),
    [
        (alike, GREATER, 0.07, 0.07),
        (partial(normal, {"a": -0.5, "b": 0.0}), {**GREATER, "margin": 0.5}, 0.07, 0.07),
        (partial(normal, dict.fromkeys("abc", 0.0)), {**ORDER, "greater": ["a", ["b", "c"]]}, 0.05, 0.08),
        (partial(normal, {"a": 15.0, "b": 10.0}), RATIO, 0.07, 0.07),
        # Holm's correction holds over the three means: none is below 0.
        (partial(columns, (0.0, 0.0, 0.0)), TestMeans.TEST, 0.05, 0.07),
        (partial(normal, {"a": 12.0, "b": 10.0}), {**ALIKE, "labels": ["a", "b"]}, 0.07, 0.07),
        (partial(curves, 1.0), {**SIMILAR, "spread_at": 10}, 0.05, 0.1),
        (partial(normal, {"a": 3.0}), {"kind": "mean", **OF_A, "above": 3.0}, 0.07, 0.07),
    ],
)
def test_on_the_bound_little_is_decided(make, test, confirmed, refuted, monkeypatch):
    """About as often as an interval of 95% is wrong on that side."""
    monkeypatch.setattr(statistics, "bootstrap_means", partial(statistics.bootstrap_means, resamples=1000))
    count = Counter(judge(make(runs=60, seed=seed), test).verdict for seed in range(150))
    assert count[YES] / 150 < confirmed and count[NO] / 150 < refuted, count


def test_settings_that_do_not_go_together_are_refused():
    latency, parts = {"kind": "latency", "labels": ["a"]}, {**GREATER, "parts": 4}
    late = {"from": 1, "to": 8, "counted_from": "first-success"}
    for told, *tests in (
        ("either one label and below, or", latency, {**latency, "labels": ["a", "b"], "below": 1.0}),
        ("either below or factor", {**latency, "below": 1.0, "factor": 2.0}),
        ("tolerance: got 1; allowed for a share: < 1", {**SHARE_OF_A, "tolerance": 1.0}),
        (
            "censored_at: needs a column of runs.parquet",
            *({**GREATER, "censored_at": 5.0} | at for at in ({"step": 3}, {"window": {"from": 1, "to": 2}})),
        ),
        (
            "parts: got 4; allowed: a number that divides",
            *({**parts, "window": window} for window in (None, {"from": 1, "to": 30}, {"from": 1, "to": 4})),
        ),
        ("counted from the start", {**parts, "window": late}),
    ):
        for test in tests:
            with pytest.raises(pydantic.ValidationError, match=told):
                judge(None, test)


def test_too_few_runs_and_missing_columns_say_so():
    few = curves(0.0, runs=MIN_RUNS - 1)
    few.runs["value"][:] = 10.0
    for test in (
        {"kind": "mean", "above": 0.0, **OF_A},
        {"kind": "agrees", "mean": 1.0, "sd": 1.0, "runs": 20, **OF_A},
        SHARE_OF_A,
        {**ORDER, "less": ["a", "b"]},
        {**ORDER, "greater": ["a", ["b", "c"]], "margin": 1.0},
        RATIO,
        {**SIMILAR, "spread_at": 10},
        ALIKE,
    ):
        with pytest.raises(Undecidable, match=f"at least {MIN_RUNS}"):
            judge(few, {**test, "by": "variant"})
        with pytest.raises(Undecidable, match="no column rmse"):
            judge(curves(0.0), {**test, "column": "rmse"})


def test_success_within_steps_needs_runs_that_end_at_success():
    claim = {"test": {"kind": "share", "label": "a", "column": "value", "within": 6, "above": 0.5}}
    problem = {"kind": "space-modelling", "target_area": [1, 0, 2, 1]}
    (entry,) = evaluate(in_memory({"a": {"value": np.arange(40) < 30}}, problem=problem, claims=[claim]))
    assert entry.verdict == OPEN and "continues after its success" in entry.test.reason
