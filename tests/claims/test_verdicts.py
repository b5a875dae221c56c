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
RATIO = {"kind": "ratio", "column": "value", "label": "a", "to": "b", "tolerance": 0.25}
SIMILAR = {"kind": "similar", "column": "value", "labels": ["a", "b", "c"], "step": 4, "margin": 0.1}
ALIKE = {"kind": "similar", "column": "value", "labels": ["a", "b", "c"], "factor": 1.2}


def normal(means, runs=200, noise=1.0, seed=0):
    """Values with these means; runs of equal index share most of what they owe to chance."""
    random = np.random.default_rng(seed)
    shared = random.normal(size=runs)
    return in_memory(
        {name: {"value": mean + shared + noise * random.normal(size=runs)} for name, mean in means.items()}
    )


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


def rates(make, test, monkeypatch, times=150):
    """Share of made-up data sets that end in each verdict."""
    monkeypatch.setattr(statistics, "bootstrap_means", partial(statistics.bootstrap_means, resamples=1000))
    count = Counter(judge(make(seed), test).verdict for seed in range(times))
    return {verdict: count[verdict] / times for verdict in ("reproduced", "not reproduced", "inconclusive")}


class TestLatency:
    """Times with known ranges: of `b` they overlap with those of `c`."""

    TIMES = {"a": (0.1, 0.09, 0.12), "b": (0.2, 0.15, 0.3), "c": (0.25, 0.24, 0.4), "d": (0.9, 0.8, 1.0)}

    @pytest.fixture
    def results(self):
        results = normal(dict.fromkeys(self.TIMES, 0.0))
        seconds = {str(point.index): list(self.TIMES[point.name]) for point in results.points}
        results.__dict__["latency"] = Latency(seconds=seconds)
        return results

    @pytest.mark.parametrize(
        ("labels", "verdict"),
        [
            (["a", "b", "d"], "reproduced"),
            (["a", "b", "c"], "inconclusive"),
            (["b", "a", "d"], "not reproduced"),
            (["c", "b", "a"], "not reproduced"),
        ],
    )
    def test_an_order_holds_where_no_ranges_overlap(self, results, labels, verdict):
        finding = judge(results, {"kind": "latency", "labels": labels})
        assert finding.verdict == verdict
        assert finding.ours.split(" < ")[0].startswith("a ") == ("a" in labels)
        first = finding.comparisons[0].interval
        (quick, quick_low, quick_high), (slow, slow_low, slow_high) = (
            self.TIMES[each] for each in labels[:2]
        )
        assert (first.estimate, first.low, first.high) == pytest.approx(
            (slow / quick, slow_low / quick_high, slow_high / quick_low)
        )

    @pytest.mark.parametrize(
        ("below", "verdict"), [(0.31, "reproduced"), (0.2, "inconclusive"), (0.14, "not reproduced")]
    )
    def test_a_bound_has_to_exceed_every_time(self, results, below, verdict):
        finding = judge(results, {"kind": "latency", "labels": ["b"], "below": below})
        assert (finding.verdict, finding.ours) == (verdict, 0.2)

    @pytest.mark.parametrize(
        ("labels", "factor", "verdict"),
        [
            (["c", "b", "d"], 7.0, "reproduced"),
            (["d", "c", "b"], 5.0, "inconclusive"),
            (["b", "a", "d"], 1.2, "not reproduced"),
        ],
    )
    def test_times_are_alike_where_all_ratios_to_the_first_are_within_a_factor(
        self, results, labels, factor, verdict
    ):
        finding = judge(results, {"kind": "latency", "labels": labels, "factor": factor})
        assert finding.verdict == verdict
        first, *others = labels
        assert [each.of for each in finding.comparisons] == [f"{name} / {first}" for name in others]

    def test_without_a_measurement_nothing_is_said(self):
        with pytest.raises(Undecidable, match="not measured: run `bojax bench latency "):
            judge(normal({"a": 0.0}), {"kind": "latency", "labels": ["a"], "below": 1.0})

    @pytest.mark.parametrize("test", [{"labels": ["a"]}, {"labels": ["a", "b"], "below": 1.0}])
    def test_it_is_a_bound_or_an_order(self, test):
        with pytest.raises(pydantic.ValidationError, match="either one label and below, or several labels"):
            registry["test"]["latency"].model_validate(test)
        with pytest.raises(pydantic.ValidationError, match="either below or factor"):
            registry["test"]["latency"].model_validate({"labels": ["a"], "below": 1.0, "factor": 2.0})


class TestOrder:
    def test_the_smaller_may_come_first(self):
        results = normal({"a": 0.0, "b": 1.0, "c": 2.0})
        finding = judge(results, {**ORDER, "less": ["a", "b", "c"]})
        assert finding.verdict == "reproduced"
        assert [comparison.of for comparison in finding.comparisons] == ["b - a", "c - b"]
        assert re.fullmatch(r"a \S+ < b \S+ < c \S+", str(finding.ours))
        assert judge(results, {**ORDER, "less": ["a", "c", "b"]}).verdict == "not reproduced"

    def test_both_directions_say_the_same(self):
        results = normal({"a": 0.0, "b": 0.1})
        up, down = (
            judge(results, {**ORDER, **way}) for way in ({"less": ["a", "b"]}, {"greater": ["b", "a"]})
        )
        assert up.comparisons == down.comparisons and up.verdict == down.verdict

    def test_several_names_may_share_a_place(self):
        results = normal({"a": 0.0, "b": 1.0, "c": 1.0, "d": 2.0})
        finding = judge(results, {**ORDER, "less": ["a", ["b", "c"], "d"]})
        assert finding.verdict == "reproduced"
        assert [c.of for c in finding.comparisons] == ["b - a", "c - a", "d - b", "d - c"]
        assert judge(results, {**ORDER, "less": ["b", ["a", "c"]]}).verdict == "not reproduced"
        assert judge(results, {**ORDER, "greater": ["d", ["a", "b", "c"]]}).verdict == "reproduced"

    def test_of_several_variants_the_best_stands_for_a_label_in_either_direction(self):
        results = normal({"a": 0.0, "b": 1.0, "c": 2.0})
        points = tuple(
            type(point)(**{**vars(point), "label": "one" if point.name == "a" else "other"})
            for point in results.points
        )
        other = type(results)(results.folder, results.manifest, points)
        other.__dict__["runs"] = results.runs
        assert judge(other, {**ORDER, "less": ["one", "other"]}).chosen == {"other": "b"}
        assert judge(other, {**ORDER, "greater": ["other", "one"]}).chosen == {"other": "c"}

    @pytest.mark.parametrize(
        ("lag", "verdict"), [(0.0, "reproduced"), (0.5, "inconclusive"), (1.0, "not reproduced")]
    )
    def test_a_margin_allows_for_a_small_lag(self, lag, verdict):
        results = normal({"a": -lag, "b": 0.0}, runs=100)
        finding = judge(results, {**ORDER, "greater": ["a", "b"], "margin": 0.5})
        assert finding.verdict == verdict
        assert finding.decisive.of == "a - b + 0.5"
        assert finding.decisive.interval.estimate == pytest.approx(
            0.5 + np.diff(results.paired(results.points[::-1], "value")).mean()
        )

    @pytest.mark.parametrize(
        ("mean", "verdict"), [(9.9, "reproduced"), (9.0, "inconclusive"), (8.0, "not reproduced")]
    )
    @pytest.mark.parametrize("sign", [1, -1])
    def test_a_margin_can_be_a_share_of_a_lead(self, mean, verdict, sign):
        # 10% of the lead of b over c is 1: a has to be above 9.
        results = normal({"a": sign * mean, "b": sign * 10.0, "c": 0.0})
        way = "greater" if sign > 0 else "less"
        finding = judge(results, {**ORDER, way: ["a", "b"], "margin": 0.1, "baseline": "c"})
        assert finding.verdict == verdict

    @pytest.mark.parametrize(
        ("mean", "verdict"), [(21.0, "reproduced"), (20.0, "inconclusive"), (19.0, "not reproduced")]
    )
    def test_a_lead_can_have_to_be_a_multiple_of_the_next(self, mean, verdict):
        # Twice the lead of b over c is 20.
        results = normal({"a": mean, "b": 10.0, "c": 0.0})
        finding = judge(results, {**ORDER, "greater": ["a", "b"], "margin": -1.0, "baseline": "c"})
        assert finding.verdict == verdict
        assert finding.decisive.of == "a - b - 1 (b - c)"

    @pytest.mark.parametrize(("limit", "verdict"), [(5.0, "reproduced"), (0.5, "not reproduced")])
    def test_a_number_stands_for_missing_ones(self, limit, verdict):
        results = in_memory({"a": {"value": np.ones(40)}, "b": {"value": np.full(40, np.nan)}})
        test = {**ORDER, "less": ["a", "b"]}
        with pytest.raises(Undecidable, match="40 runs of b without a finite value"):
            judge(results, test)
        finding = judge(results, {**test, "censored_at": limit})
        assert finding.verdict == verdict
        assert f"value ({limit:g} where missing)" in finding.method and f"b {limit:g}" in finding.ours

    def test_shares_are_compared_run_by_run(self):
        finding = judge(flags(200, 30, 10), {**ORDER, "greater": ["a", "b"]})
        assert finding.verdict == "reproduced"
        assert finding.decisive.interval.estimate == pytest.approx(0.1)
        assert judge(flags(200, 10, 30), {**ORDER, "greater": ["a", "b"]}).verdict == "not reproduced"

    def test_the_interval_of_a_share_is_that_of_bonett_and_price(self):
        finding = judge(flags(200, 30, 10), {**ORDER, "greater": ["a", "b"]})
        first, second = 31 / 202, 11 / 202
        half = 1.96 * np.sqrt((first + second - (first - second) ** 2) / 202)
        bounds = finding.decisive.interval.low, finding.decisive.interval.high
        assert bounds == pytest.approx((first - second - half, first - second + half), abs=0.004)

    @pytest.mark.parametrize("few", [0, 1, 4])
    def test_few_runs_that_differ_decide_nothing_about_shares(self, few):
        # Four of four is 0.06 one-sided in the exact test of McNemar.
        finding = judge(flags(200, few, 0), {**ORDER, "greater": ["a", "b"]})
        assert finding.verdict == "inconclusive"
        assert finding.decisive.interval.low <= 0 < finding.decisive.interval.high

    def test_equal_shares_are_seldom_told_apart(self, monkeypatch):
        def make(seed):
            random = np.random.default_rng(seed)
            differing = random.binomial(60, 0.1)
            return flags(60, first := random.binomial(differing, 0.5), differing - first)

        found = rates(make, {**ORDER, "greater": ["a", "b"]}, monkeypatch)
        assert found["reproduced"] < 0.07 and found["not reproduced"] < 0.07

    def test_a_lag_of_just_the_margin_is_seldom_decided(self, monkeypatch):
        found = rates(
            lambda seed: normal({"a": -0.5, "b": 0.0}, runs=60, seed=seed),
            {**ORDER, "greater": ["a", "b"], "margin": 0.5},
            monkeypatch,
        )
        assert found["reproduced"] < 0.07 and found["not reproduced"] < 0.07

    def test_equal_means_have_no_best(self, monkeypatch):
        found = rates(
            lambda seed: normal(dict.fromkeys("abc", 0.0), runs=60, seed=seed),
            {**ORDER, "greater": ["a", ["b", "c"]]},
            monkeypatch,
        )
        assert found["reproduced"] < 0.05 and found["not reproduced"] < 0.08


class TestRatio:
    @pytest.mark.parametrize(
        ("mean", "verdict"), [(12.0, "reproduced"), (15.0, "inconclusive"), (20.0, "not reproduced")]
    )
    def test_it_is_the_interval_that_has_to_lie_within_the_tolerance(self, mean, verdict):
        # The bounds are 12 / 1.25 and 12 * 1.25 = 15.
        finding = judge(normal({"a": mean, "b": 10.0}), {**RATIO, "expected": 1.2})
        assert finding.verdict == verdict
        assert finding.ours == pytest.approx(mean / 10, abs=0.05)

    @pytest.mark.parametrize(
        ("means", "expected", "verdict"),
        [
            ((9.5, 10.0), 1.05, "not reproduced"),
            ((10.5, 10.0), 1.05, "reproduced"),
            ((10.5, 10.0), 0.95, "not reproduced"),
        ],
    )
    def test_the_opposite_order_is_never_the_expected_ratio(self, means, expected, verdict):
        results = normal(dict(zip("ab", means, strict=True)), noise=0.1)
        assert judge(results, {**RATIO, "expected": expected}).verdict == verdict

    def test_the_interval_is_paired(self):
        # What both share cancels: the ratio is known better than either mean.
        results = normal({"a": 12.0, "b": 10.0}, noise=0.01)
        interval = judge(results, {**RATIO, "expected": 1.2}).decisive.interval
        mean = statistics.mean_interval(results.paired(results.points[:1], "value")[:, 0])
        assert interval.high - interval.low < 0.3 * (mean.high - mean.low) / 10

    @pytest.mark.parametrize(
        ("expected", "told"), [(1.3, "above 1, as claimed"), (0.8, "above 1, contrary to the claim")]
    )
    def test_the_direction_is_said(self, expected, told):
        finding = judge(normal({"a": 12.0, "b": 10.0}), {**RATIO, "expected": expected})
        assert told in finding.method

    def test_wide_intervals_decide_nothing(self):
        finding = judge(normal({"a": 12.0, "b": 10.0}, runs=20, noise=10.0), {**RATIO, "expected": 1.2})
        assert finding.verdict == "inconclusive"

    @pytest.mark.parametrize("means", [{"a": 1.0, "b": 0.1}, {"a": -5.0, "b": 10.0}])
    def test_means_around_zero_have_no_ratio(self, means):
        with pytest.raises(Undecidable, match="not clearly positive"):
            judge(normal(means, runs=50), {**RATIO, "expected": 1.2})

    def test_a_ratio_on_the_bound_is_seldom_decided(self, monkeypatch):
        found = rates(
            lambda seed: normal({"a": 15.0, "b": 10.0}, runs=60, seed=seed),
            {**RATIO, "expected": 1.2},
            monkeypatch,
        )
        assert found["reproduced"] < 0.07 and found["not reproduced"] < 0.07


class TestSimilar:
    @pytest.mark.parametrize(
        ("gap", "verdict"), [(0.0, "reproduced"), (1.0, "inconclusive"), (3.0, "not reproduced")]
    )
    def test_differences_are_held_against_a_share_of_the_spread(self, gap, verdict):
        finding = judge(curves(gap), {**SIMILAR, "spread_at": 10})
        assert finding.verdict == verdict
        assert [comparison.of for comparison in finding.comparisons] == ["a - b", "a - c", "b - c"]

    def test_without_a_spread_the_margin_is_in_the_columns_unit(self):
        assert judge(curves(0.0), {**SIMILAR, "margin": 1.0}).verdict == "reproduced"
        assert judge(curves(3.0), {**SIMILAR, "margin": 1.0}).verdict == "not reproduced"

    @pytest.mark.parametrize(
        ("c", "verdict"), [(10.5, "reproduced"), (12.0, "inconclusive"), (13.0, "not reproduced")]
    )
    def test_with_a_factor_all_ratios_are_held_against_it(self, c, verdict):
        finding = judge(normal({"a": 10.0, "b": 10.0, "c": c}), ALIKE)
        assert finding.verdict == verdict
        assert [comparison.of for comparison in finding.comparisons] == ["a / b", "a / c", "b / c"]
        # The order of the names decides nothing: a ratio of 1.2 is as far from 1 as its inverse.
        assert judge(normal({"a": c, "b": 10.0, "c": 10.0}), ALIKE).verdict == verdict

    def test_two_names_have_the_interval_of_their_ratio(self):
        results = normal({"a": 10.5, "b": 10.0})
        expected = judge(results, {**RATIO, "expected": 1.2}).decisive.interval
        found = judge(results, {**ALIKE, "labels": ["a", "b"]}).decisive.interval
        np.testing.assert_allclose(
            [found.estimate, found.low, found.high], [expected.estimate, expected.low, expected.high]
        )

    def test_a_ratio_of_just_the_factor_is_seldom_decided(self, monkeypatch):
        found = rates(
            lambda seed: normal({"a": 12.0, "b": 10.0}, runs=60, seed=seed),
            {**ALIKE, "labels": ["a", "b"]},
            monkeypatch,
        )
        assert found["reproduced"] < 0.07 and found["not reproduced"] < 0.07

    def test_means_around_zero_have_no_ratios(self):
        with pytest.raises(Undecidable, match="not clearly positive"):
            judge(normal({"a": 1.0, "b": 0.0, "c": 1.0}, runs=50), ALIKE)

    def test_no_difference_at_either_step_is_no_similarity(self):
        # The spread is then nothing but chance, and so is any share of it.
        assert judge(curves(0.0, spread=0.0), {**SIMILAR, "spread_at": 10}).verdict == "inconclusive"

    def test_a_gap_of_just_the_margin_is_seldom_decided(self, monkeypatch):
        found = rates(lambda seed: curves(1.0, runs=60, seed=seed), {**SIMILAR, "spread_at": 10}, monkeypatch)
        assert found["reproduced"] < 0.05 and found["not reproduced"] < 0.1

    def test_a_step_that_no_run_reached_is_a_reason(self):
        with pytest.raises(Undecidable, match="the longest took 10"):
            judge(curves(0.0), {**SIMILAR, "step": 11})


@pytest.mark.parametrize(
    "test",
    [
        {**ORDER, "less": ["a", "b"]},
        {**ORDER, "greater": ["a", ["b", "c"]], "margin": 1.0},
        {**RATIO, "expected": 1.2},
        {**SIMILAR, "spread_at": 10},
        ALIKE,
    ],
)
def test_too_few_runs_and_missing_columns_say_so(test):
    few, nobody = curves(0.0, runs=MIN_RUNS - 1), {**test, "by": "variant"}
    for point in few.points:
        few.runs["value"][few.runs["point"] == point.index] = 10.0
    with pytest.raises(Undecidable, match=f"at least {MIN_RUNS}"):
        judge(few, nobody)
    with pytest.raises(Undecidable, match="no column rmse"):
        judge(curves(0.0), {**test, "column": "rmse"})


def test_success_within_steps_needs_runs_that_end_at_success():
    claim = {"test": {"kind": "share", "label": "a", "column": "value", "within": 6, "above": 0.5}}
    results = flags(40, 30, 0)
    walled = in_memory(
        {point.name: {"value": results.runs_of(point)["value"]} for point in results.points},
        problem={"kind": "space-modelling", "target_area": [1, 0, 2, 1]},
        claims=[claim],
    )
    (entry,) = evaluate(walled)
    assert entry["verdict"] == "inconclusive" and "continues after its success" in entry["test"]["reason"]
