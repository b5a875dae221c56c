"""Verdicts of the tests on episodes, on printed numbers and on growth, on data whose truth is known."""

import numpy as np
import pytest

from bojax.claims.samples import MIN_RUNS
from bojax.report.findings import Undecidable
from tests.claims.test_verdicts import NO, OPEN, YES, judge
from tests.report.synthetic import in_memory

FIRST, LAST = {"from": 1, "to": 10}, {"from": 21, "to": 30}


def learners(ends, runs=200, noise=1.0, seed=0, **more):
    """Thirty episodes that rise from 0 to these ends; what a run owes to chance lasts over all episodes."""
    random = np.random.default_rng(seed)
    rise = np.clip((np.arange(1, 31) - 10) / 10, 0, 1)
    episodes = {
        name: end * rise + random.normal(size=(runs, 1)) + noise * random.normal(size=(runs, 30))
        for name, end in ends.items()
    }
    return in_memory({name: {"value": np.full(runs, 7.0)} for name in ends}, episodes=episodes, **more)


def succeeding(lengths):
    """One point with episodes of these lengths, those shorter than 500 with a success."""
    results = in_memory({"a": {"value": np.zeros(len(lengths))}}, episodes={"a": lengths})
    results.episodes["success"] = results.episodes["value"] < 500.0
    return results


def numbers(values):
    """One point with a column `value`."""
    return in_memory({"a": {"value": np.asarray(values)}})


class TestWindow:
    def test_a_runs_value_is_its_mean_over_the_episodes(self):
        results = learners({"a": 5.0, "b": 3.0})
        test = {"kind": "order", "column": "value", "window": LAST, "greater": ["a", "b"]}
        finding = judge(results, test)
        a, b = (results.by_episode(point, "value")[:, 20:30].mean(axis=1) for point in results.points)
        assert finding.verdict == YES
        assert finding.decisive.interval.estimate == pytest.approx((a - b).mean())
        assert "mean value of episodes 21 to 30" in finding.method
        assert judge(results, {**test, "greater": ["b", "a"]}).verdict == NO
        assert judge(results, {**test, "window": FIRST}).verdict == OPEN  # where they do not differ
        # Without a window it is the column of the run.
        assert judge(results, {"kind": "mean", "label": "a", "column": "value", "above": 6.0}).ours == 7.0

    def test_a_curve_lies_above_another_if_it_does_in_every_part(self):
        # `a` ends higher, and so does its mean, but the curves begin alike, or cross.
        test = {"kind": "order", "column": "value", "window": {"from": 1, "to": 30}, "greater": ["a", "b"]}
        alike, crossing = learners({"a": 5.0, "b": 3.0}), learners({"a": 5.0, "b": 3.0})
        values = crossing.episodes["value"]
        values[(crossing.episodes["point"] == 1) & (crossing.episodes["episode"] <= 10)] += 1.0
        for results, verdict in ((alike, OPEN), (crossing, NO)):
            assert judge(results, test).verdict == YES
            finding = judge(results, {**test, "parts": 3})
            assert finding.verdict == verdict
            ends = [f"a - b in episodes {end}" for end in ("1 to 10", "11 to 20", "21 to 30")]
            assert [each.of for each in finding.comparisons] == ends
            assert finding.decisive == finding.comparisons[0]
            a, b = (results.by_episode(point, "value")[:, 20:30].mean(axis=1) for point in results.points)
            assert finding.comparisons[2].interval.estimate == pytest.approx((a - b).mean())
        assert judge(alike, {**test, "window": {"from": 15, "to": 30}, "parts": 4}).verdict == YES

    def test_tests_after_an_episode_are_averaged_and_kept_apart_from_training(self):
        runs = 30
        tests = {"a": np.stack([np.full((runs, 30), level) for level in (1.0, 2.0, 6.0)], axis=-1)}
        results = learners({"a": 0.0}, runs=runs, tests=tests)
        test = {"kind": "mean", "label": "a", "column": "value", "above": 2.0}
        assert judge(results, {**test, "window": {**LAST, "phase": "test"}}).ours == pytest.approx(3.0)
        assert judge(results, {**test, "window": {**LAST, "phase": "train"}}).verdict == NO

    def test_what_has_changed_since_can_be_compared(self):
        results = learners({"a": 5.0, "b": 5.0, "c": 3.0})
        changed = {"column": "value", "window": LAST, "since": FIRST}
        alike = {"kind": "similar", "labels": ["a", "b"], "margin": 0.5, **changed}
        assert judge(results, alike).verdict == YES
        assert judge(results, {**alike, "labels": ["a", "c"]}).verdict == NO
        risen = judge(results, {"kind": "mean", "label": "c", "above": 0.0, **changed})
        assert risen.verdict == YES and risen.ours == pytest.approx(3.0, abs=0.2)

    def test_a_ratio_of_means_over_episodes(self):
        test = {"kind": "ratio", "column": "value", "label": "a", "to": "b", "tolerance": 0.2, "window": LAST}
        results = learners({"a": 50.0, "b": 25.0})
        assert judge(results, {**test, "expected": 2.0}).verdict == YES
        assert judge(results, {**test, "expected": 1.5}).verdict == NO

    def test_similar_over_episodes_may_be_a_share_of_a_spread(self):
        test = {"kind": "similar", "column": "value", "labels": ["a", "b", "c"], "window": FIRST}
        results = learners({"a": 0.0, "b": 5.0, "c": 20.0})
        assert judge(results, {**test, "margin": 0.05, "spread_at": LAST}).verdict == YES
        assert judge(results, {**test, "margin": 0.01, "spread_at": LAST}).verdict == OPEN
        assert judge(results, {**test, "window": LAST, "margin": 0.5}).verdict == NO

    def test_the_best_variant_of_a_label_is_the_best_in_these_episodes(self):
        swept = {"early": {"label": "a"}, "late": {"label": "a"}}
        results = learners({"early": 0.0, "late": 5.0, "b": 2.0}, swept=swept)
        test = {"kind": "order", "column": "value", "greater": ["a", "b"], "window": LAST}
        assert judge(results, test).chosen == {"a": "late"}

    def test_episodes_that_are_missing_are_a_reason(self):
        test = {"kind": "mean", "label": "a", "column": "value", "above": 0.0}
        results, holed = learners({"a": 1.0}), learners({"a": 1.0})
        hole = (holed.episodes["run"] == 3) & (holed.episodes["episode"] == 25)
        holed.episodes["value"][hole] = np.nan
        for given, window, reason in (
            (results, {"from": 1, "to": 31}, "no run has an episode 31: the last one is 30"),
            (results, {"from": 1, "to": 2, "phase": "test"}, "the last one is 0"),
            (numbers(np.ones(30)), LAST, "no episodes"),
            (holed, LAST, "1 run of a without a finite mean value of episodes 21 to 30"),
        ):
            with pytest.raises(Undecidable, match=reason):
                judge(given, {**test, "window": window})

    def test_episodes_can_be_counted_from_the_first_success(self):
        runs, lengths = 40, np.full((40, 30), 500.0)
        first = np.arange(runs) % 8  # episodes before the first success
        for run, start in enumerate(first):
            lengths[run, start:] = 300.0 - 10.0 * np.arange(30 - start)
        results = succeeding(lengths)
        window = {"from": 3, "to": 4, "counted_from": "first-success"}
        test = {"kind": "mean", "label": "a", "column": "value", "window": window}
        test |= {"above": 274.0, "below": 276.0}
        finding = judge(results, test)
        assert finding.ours == 275.0 and finding.verdict == YES and finding.runs == runs
        assert "episodes 3 to 4, counted from the first success" in finding.method
        fall = {"kind": "trend", "label": "a", "column": "value", "direction": "falls"}
        later = {**window, "from": 11, "to": 11}
        assert judge(results, {**fall, "from": window, "to": later}).ours == -75.0

    def test_runs_without_these_episodes_are_left_out_up_to_a_share(self):
        results = succeeding(np.repeat([500.0, 100.0], [2, 38])[:, None] * np.ones(30))  # two never succeed
        window = {"from": 1, "to": 20, "counted_from": "first-success"}
        test = {"kind": "mean", "label": "a", "column": "value", "below": 200.0}
        with pytest.raises(Undecidable, match="2 runs of a without a finite"):
            judge(results, {**test, "window": window})
        finding = judge(results, {**test, "window": {**window, "missing": 0.05}})
        assert finding.ours == 100.0 and finding.runs == 38
        with pytest.raises(Undecidable, match="more than 4%"):
            judge(results, {**test, "window": {**window, "missing": 0.04}})

    def test_the_spread_of_episodes_can_be_compared(self):
        wide, narrow = learners({"a": 0.0}, noise=3.0), learners({"a": 0.0}, noise=1.0, seed=1)
        values = {name: of.by_episode(of.points[0], "value") for name, of in (("w", wide), ("n", narrow))}
        results = in_memory({name: {"value": np.zeros(200)} for name in values}, episodes=values)
        test = {"kind": "order", "column": "value", "window": LAST, "statistic": "sd"}
        finding = judge(results, {**test, "greater": ["w", "n"]})
        sd = {name: value[:, 20:30].std(axis=1, ddof=1) for name, value in values.items()}
        assert finding.verdict == YES
        assert finding.decisive.interval.estimate == pytest.approx((sd["w"] - sd["n"]).mean())
        assert "standard deviation of value of episodes 21 to 30" in finding.method
        assert judge(results, {**test, "greater": ["n", "w"]}).verdict == NO


class TestShareOfRunsInAWindow:
    def flags(self, at, runs=40, last=10):
        """A run for each entry of `at`: the episode where the flag is true, 0 for never."""
        at = np.resize(at, runs)
        episodes = (np.arange(1, last + 1)[None, :] == at[:, None]).astype(float)
        return in_memory({"a": {"success": at > 0}}, episodes={"a": episodes})

    def test_a_run_counts_if_it_holds_in_any_of_the_episodes(self):
        test = {"kind": "share", "label": "a", "column": "value", "window": {"from": 1, "to": 3}}
        finding = judge(self.flags([1, 3, 4, 0]), {**test, "above": 0.2})
        assert finding.ours == 0.5 and finding.verdict == YES
        assert judge(self.flags([1, 3, 4, 0]), {**test, "above": 0.8}).verdict == NO

    def test_a_run_may_end_at_its_success_but_not_before(self):
        results = self.flags([1, 2])
        episodes = results.episodes
        is_kept = episodes["episode"] <= np.where(episodes["run"] % 2 == 0, 1, 2)
        ended = {key: column[is_kept] for key, column in episodes.items()}
        results.__dict__["episodes"] = ended
        test = {"kind": "share", "label": "a", "column": "value", "window": {"from": 1, "to": 2}}
        assert judge(results, {**test, "above": 0.5}).ours == 1.0
        ended["value"][0] = 0.0
        results._known.clear()
        with pytest.raises(Undecidable, match="1 run of a without"):
            judge(results, {**test, "above": 0.5})

    def test_steps_of_learning_do_not_tell_when_it_succeeded(self):
        test = {"kind": "share", "label": "a", "column": "success", "within": 6, "above": 0.5}
        with pytest.raises(Undecidable, match="continues after its success"):
            judge(self.flags([1, 2]), test)


class TestMean:
    def test_it_lies_between_thresholds(self):
        results = learners({"a": 5.1})
        test = {"kind": "mean", "label": "a", "column": "value", "window": LAST}
        for bounds, verdict in (
            ({"above": 4.0}, YES),
            ({"above": 5.0}, OPEN),
            ({"above": 6.0}, NO),
            ({"below": 6.0}, YES),
            ({"below": 4.0}, NO),
            ({"above": 4.0, "below": 6.0}, YES),
            ({"above": 5.0, "below": 6.0}, OPEN),
            ({"above": 1.0, "below": 4.0}, NO),
        ):
            assert judge(results, {**test, **bounds}).verdict == verdict, bounds


class TestTrendOverEpisodes:
    TEST = {"kind": "trend", "label": "a", "column": "value", "from": FIRST, "to": LAST}

    def test_a_mean_rises_or_falls_between_windows(self):
        back = {"from": LAST, "to": FIRST, "direction": "falls"}
        for end, verdict in ((5.0, YES), (0.0, OPEN), (-5.0, NO)):
            for way in ({"direction": "rises"}, back):
                assert judge(learners({"a": end}), {**self.TEST, **way}).verdict == verdict

    def test_the_change_is_paired_within_a_run(self):
        finding = judge(learners({"a": 1.0}, noise=0.1), {**self.TEST, "direction": "rises"})
        assert finding.decisive.of == "change of a from episodes 1 to 10 to episodes 21 to 30"
        assert finding.decisive.interval.high - finding.decisive.interval.low < 0.05


class TestAgrees:
    MEAN = {"kind": "agrees", "label": "a", "column": "value", "mean": 2.95, "sd": 0.38, "runs": 20}
    SHARE = {"kind": "agrees", "label": "a", "column": "value", "share": 0.9, "runs": 20}

    def test_of_a_mean(self):
        noise = np.random.default_rng(1).normal(size=200)
        noise = (noise - noise.mean()) / noise.std()
        for mean, sd, more, verdict in (
            (2.95, 0.5, {}, YES),
            (3.5, 0.5, {}, NO),
            (2.0, 0.5, {}, NO),
            (2.95, 3.0, {}, OPEN),  # the interval is wider than the printed deviation
            (2.95, 0.5, {"tolerance": 0.1}, OPEN),
        ):
            finding = judge(numbers(mean + sd * noise), {**self.MEAN, **more})
            assert finding.verdict == verdict and finding.ours == pytest.approx(mean)

    def test_a_mean_over_successes_alone_is_not_compared_unless_allowed(self):
        values = np.random.default_rng(1).normal(2.95, 0.5, size=200)
        values[:4] = np.nan
        with pytest.raises(Undecidable, match="4 of 200 runs of a have no value, so that the mean"):
            judge(numbers(values), self.MEAN)
        with pytest.raises(Undecidable, match="more than 1%"):
            judge(numbers(values), {**self.MEAN, "missing": 0.01})
        finding = judge(numbers(values), {**self.MEAN, "missing": 0.02})
        assert finding.runs == 196 and finding.ours == pytest.approx(values[4:].mean())

    def test_what_never_varies_agrees_exactly_or_not(self):
        test = {**self.MEAN, "mean": 1.0, "sd": 0.0, "tolerance": 0.1}
        assert judge(numbers(np.ones(50)), test).verdict == YES
        assert judge(numbers(np.full(50, 2.0)), test).verdict == NO

    def test_a_printed_deviation_of_0_does_not_make_the_printed_mean_exact(self):
        # 5 of 200 runs need a second episode. That none of 20 printed runs did has a probability of 60%.
        values = np.where(np.arange(200) < 5, 2.0, 1.0)
        finding = judge(numbers(values), {**self.MEAN, "mean": 1.0, "sd": 0.0, "tolerance": 0.5})
        twin = judge(numbers(values), {**self.MEAN, "mean": 1.0, "sd": values.std(ddof=1), "tolerance": 0.5})
        assert finding.verdict == YES and finding.decisive.interval == twin.decisive.interval
        assert "1.00 (sd 0, taken as ours, 20 runs)" in finding.method

    def test_of_a_share(self):
        # 18 of 20 printed: their own interval is 70% to 97%.
        for hits, more, verdict in (
            (180, {}, YES),
            (200, {}, NO),
            (80, {}, NO),
            (180, {"runs": 10}, OPEN),  # ten printed runs say little
            (200, {"share": 1.0}, YES),
        ):
            finding = judge(numbers(np.arange(200) < hits), {**self.SHARE, **more})
            assert finding.verdict == verdict and finding.ours == hits / 200
        assert finding.decisive.interval.estimate == 0.0

    def test_a_share_needs_a_number_of_every_run(self):
        """A missing time to the goal is no time, and text is neither true nor false."""
        for values, reason in (
            ([np.nan, 3.0] * 20, "20 runs of a without a finite value"),
            (["b"] * 40, "holds neither Booleans nor numbers"),
        ):
            for test in (self.SHARE, {"kind": "share", "label": "a", "column": "value", "above": 0.5}):
                with pytest.raises(Undecidable, match=reason):
                    judge(numbers(values), test)

    def test_a_share_leaves_out_as_many_runs_as_the_claim_allows(self):
        results = numbers([np.nan] * 4 + [1.0] * 18 + [0.0] * 18)
        finding = judge(results, {**self.SHARE, "missing": 0.1})
        assert (finding.ours, finding.runs) == (0.5, 36)
        with pytest.raises(Undecidable, match="4 of 40 runs of a have no value, more than 9%"):
            judge(results, {**self.SHARE, "missing": 0.09})

    def test_fishers_exact_test_tells_shares_apart(self):
        # 19 of 20 and 200 of 200: p = 0.09, although Newcombe's interval of the difference excludes 0.
        for share, verdict in ((0.95, YES), (0.8, NO)):
            finding = judge(numbers(np.ones(200, dtype=bool)), {**self.SHARE, "share": share})
            assert finding.verdict == verdict and finding.decisive.interval.low > 0
            assert ("(p = 0.0909)" in finding.method) == (share == 0.95)

    def test_equal_means_are_seldom_said_to_differ(self):
        # The printed mean is itself a draw: that of a sample of 20.
        verdicts = []
        for seed in range(200):
            ours, printed = (
                np.random.default_rng(s).gamma(4.0, size=n) for s, n in ((seed, 50), (1000 + seed, 20))
            )
            test = {**self.MEAN, "mean": printed.mean(), "sd": printed.std(ddof=1)}
            verdicts.append(judge(numbers(ours), test).verdict)
        assert verdicts.count(NO) / 200 < 0.09
        assert verdicts.count(YES) / 200 > 0.8


class TestGrowth:
    X = (2, 5, 8, 11, 14, 17, 20)
    LAWS = {
        "linear": lambda x: 4 + 3 * x,
        "quadratic": lambda x: 2.1 * x**2 - x,
        "exponential": lambda x: 3 * np.exp(0.3 * x),
    }
    TEST = {"kind": "growth", "label": "a", "column": "value", "over": "env.length", "expected": "linear"}

    def chains(self, law, runs=200, seed=0, spread: float | None = 0.5, x=X):
        """Waiting times with these means and this relative spread; None for that of a random walk."""
        random = np.random.default_rng(seed)
        names = {f"a{n}": {"label": "a", "env.length": n} for n in x}
        runs_of = {}
        for name, swept in names.items():
            mean = law(float(swept["env.length"]))
            draw = random.exponential(size=runs) if spread is None else 1 + spread * random.normal(size=runs)
            runs_of[name] = {"value": mean * draw}
        return in_memory(runs_of, swept=names)

    @pytest.mark.parametrize("truth", LAWS)
    def test_the_true_law_is_found(self, truth):
        results = self.chains(self.LAWS[truth], spread=0.5 if truth == "linear" else None)
        for expected in self.LAWS:
            finding = judge(results, {**self.TEST, "expected": expected})
            assert finding.verdict == (YES if truth == expected else NO)
            assert str(finding.ours).startswith(f"{truth}: ")

    def test_coefficients_are_told(self):
        finding = judge(self.chains(lambda x: 4 + 3 * x, spread=0.01), self.TEST)
        a, b = str(finding.ours).removeprefix("linear: ").removesuffix(" x").split(" + ")
        assert (float(a), float(b)) == pytest.approx((4, 3), rel=0.02)
        assert "exponent of a power law: 0.8" in finding.method

    def test_between_two_laws_nothing_is_decided(self):
        # x to the 1.5 is as far from a line as from a parabola.
        verdicts = [judge(self.chains(lambda x: x**1.45, seed=seed), self.TEST).verdict for seed in range(4)]
        assert verdicts.count(OPEN) >= 2

    def test_few_noisy_runs_decide_nothing(self):
        flat = self.chains(lambda x: 100 + 3 * x, runs=MIN_RUNS, spread=0.2, x=(2, 8, 14, 20))
        assert judge(flat, self.TEST).verdict == OPEN

    def test_what_does_not_grow_has_no_law(self):
        for law in (lambda x: 50.0 + 0 * x, lambda x: 50.0 - x):
            with pytest.raises(Undecidable, match="does not clearly grow"):
                judge(self.chains(law, spread=0.1), self.TEST)

    def test_few_runs_that_never_arrive_are_left_out_and_said_and_many_are_a_reason(self):
        results = self.chains(self.LAWS["linear"])
        results.runs["value"][:8] = np.nan  # 4% of the runs of the shortest chain
        finding = judge(results, self.TEST)
        assert finding.verdict == YES and "8 runs without a value left out" in finding.method
        results.runs["value"][-20:] = np.nan
        with pytest.raises(Undecidable, match="20 of 200 runs of a at 20 have no value, more than 5%"):
            judge(results, self.TEST)

    def test_too_few_numbers_and_equal_ones_are_a_reason(self):
        for x, over, reason in (
            ((2, 5, 8), "env.length", "3 values of env.length: at least 4"),
            ((2, 5, 8, 9), "env.width", "env.width is not a swept number of a"),
        ):
            with pytest.raises(Undecidable, match=reason):
                judge(self.chains(self.LAWS["linear"], x=x), {**self.TEST, "over": over})
        swept = {f"a{i}": {"label": "a", "env.length": n} for i, n in enumerate((2, 2, 5, 8, 9))}
        results = in_memory({name: {"value": np.arange(30.0)} for name in swept}, swept=swept)
        with pytest.raises(Undecidable, match="several settings of a have the same env.length"):
            judge(results, self.TEST)
