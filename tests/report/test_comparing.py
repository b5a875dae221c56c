"""Comparisons: curves on common axes, scores with paired and unpaired intervals, a page, one-line errors."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bojax.cli.main import main
from bojax.envs.settings import Brax, Gymnasium, MountainCar
from bojax.report import statistics
from bojax.report import tables as report_tables
from bojax.report.comparing import tables
from bojax.report.comparing.build import compare
from bojax.report.comparing.curve_files import Rows, read_curves
from bojax.report.comparing.methods import (
    Measure,
    Options,
    measured_by,
    named,
    of_file,
    of_folder,
    task_of,
)
from bojax.report.comparing.scoring import scored, tasks_of
from bojax.report.ranking import ranking
from bojax.report.source import load
from bojax.results.store import ResultsError
from tests.report.synthetic import edit_manifest, in_memory, set_column, write_learning, write_results
from tests.report.test_report import Page
from tests.transcript import cases

EPISODES = Measure("return", False, "learning", "episode")
STEPS = Measure("return", False, "learning", "step")


def resampled_iqms(random, strata, count=4000):
    """IQMs of a stratified bootstrap as it is written down: draw, pool, sort, trim."""
    drawn = [random.choice(values, (count, len(values))) for values in strata]
    return stats.trim_mean(np.concatenate(drawn, axis=1), 0.25, axis=1)


def share_of_wins(first, second):
    """Probability of improvement by comparing every pair."""
    return float(np.mean(0.5 + 0.5 * np.sign(np.subtract.outer(first, second))))


class TestStatistics:
    def test_an_iqm_is_a_trimmed_mean(self):
        for size in (1, 2, 3, 4, 7, 8, 101):
            values = np.random.default_rng(size).normal(size=size)
            assert statistics.iqm_interval([values]).estimate == pytest.approx(stats.trim_mean(values, 0.25))

    def test_the_interval_of_an_iqm_is_that_of_a_stratified_bootstrap(self):
        random = np.random.default_rng(3)
        for sizes in ((9,), (12, 12), (5, 16, 11)):
            strata = [random.normal(3 * place, 1, size) for place, size in enumerate(sizes)]
            found = statistics.iqm_interval(strata)
            assert found.estimate == pytest.approx(stats.trim_mean(np.concatenate(strata), 0.25))
            low, high = np.quantile(resampled_iqms(random, strata), [0.025, 0.975])
            assert (found.low, found.high) == pytest.approx((low, high), abs=0.06 * (high - low))

    def test_the_probability_of_improvement_is_the_share_of_pairs(self):
        random = np.random.default_rng(5)
        first, second = random.integers(0, 6, 13), random.integers(0, 5, 9)
        found = statistics.improvement_interval([(first, second)], is_paired=False)
        assert found.estimate == pytest.approx(share_of_wins(first, second))

    @pytest.mark.parametrize("is_paired", [False, True])
    def test_the_interval_of_a_probability_is_that_of_a_bootstrap(self, is_paired):
        random = np.random.default_rng(7)
        common = random.normal(size=60)
        strata = [
            (common + random.normal(0.5, 0.4, 60), common),
            (random.normal(size=50), random.normal(size=50)),
        ]
        found = statistics.improvement_interval(strata, is_paired=is_paired)
        assert found.estimate == pytest.approx(np.mean([share_of_wins(*pair) for pair in strata]))
        shares = []
        for _ in range(3000):
            drawn = []
            for first, second in strata:
                rows = random.integers(0, len(first), len(first))
                others = rows if is_paired else random.integers(0, len(second), len(second))
                drawn.append(share_of_wins(first[rows], second[others]))
            shares.append(np.mean(drawn))
        low, high = np.quantile(shares, [0.025, 0.975])
        assert (found.low, found.high) == pytest.approx((low, high), abs=0.06 * (high - low))

    def test_the_interval_of_a_probability_of_few_runs_is_a_score_interval(self):
        """A bound is where the difference from the share is 1.96 standard deviations (Newcombe 2006)."""
        first, second = np.array([3.0, 5.0, 8.0, 9.0, 11.0]), np.array([1.0, 4.0, 5.0, 7.0])
        found = statistics.improvement_interval([(first, second)], is_paired=False)
        for bound in (found.low, found.high):
            spread = (1 - bound) / (2 - bound) + bound / (1 + bound)
            deviation = np.sqrt(bound * (1 - bound) * (1 + 3.5 * spread) / 20)
            assert abs(found.estimate - bound) == pytest.approx(1.959964 * deviation)
        apart = statistics.improvement_interval([(first + 20, second)], is_paired=True)
        assert apart.estimate == apart.high == 1.0 and 0.5 < apart.low < 0.7
        twice = statistics.improvement_interval([(first, second)] * 2, is_paired=False)
        assert twice.estimate - twice.low == pytest.approx((found.estimate - found.low) / np.sqrt(2))

    def test_many_runs_take_fewer_resamples_and_give_the_same(self):
        random = np.random.default_rng(1)
        values = random.normal(size=statistics.GROUPS + 1)
        found = statistics.iqm_interval([values])
        error = (found.high - found.low) / 2
        # The IQM of n normal values has about 1.09 / sqrt(n) as its standard deviation.
        assert error == pytest.approx(1.96 * 1.09 / np.sqrt(values.size), rel=0.15)


GOOD = "label,run,x,value\na,0,1,0.5\na,0,2,1.5\nb,0,1,2\nb,0,2,3\n"

MISTAKES = (
    ("", "is empty; allowed: the columns label, run, x, value and rows"),
    ("label,run,x,value\n", "has no rows; allowed: at least one below the header"),
    ("label,run,x\na,0,1\n", "no column value; allowed: label, run, x, value, optionally"),
    (
        "labl,run,x,value\na,0,1,2\n",
        'unknown column "labl"; allowed: label, run, task, value, x; did you mean "label"?',
    ),
    ("label,run,x,x,value\na,0,1,1,2\n", 'two columns are called "x"; allowed: one'),
    (GOOD + "b,0,3\n", "line 6: got 3 cells; allowed: 4, as in the header"),
    (GOOD + "b,0,3,nan\n", 'line 6: value: got "nan"; allowed: a finite number'),
    (GOOD + "b,0,3,-inf\n", 'line 6: value: got "-inf"; allowed: a finite number'),
    (GOOD + "b,0,3,\n", 'line 6: value: got ""; allowed: a number'),
    (GOOD + "b,0,3,high\n", 'line 6: value: got "high"; allowed: a number'),
    (GOOD + ",0,3,1\n", 'line 6: label: got ""; allowed: text that is not empty'),
    (GOOD + "b,0.5,3,1\n", 'line 6: run: got "0.5"; allowed: an integer'),
    (GOOD + "b,-1,3,1\n", 'line 6: run: got "-1"; allowed: >= 0'),
    (GOOD + "b,0,-3,1\n", 'line 6: x: got "-3"; allowed: >= 0'),
    (GOOD + "b,0,1e300,1\n", 'line 6: x: got "1e300"; allowed: <= '),
    (GOOD + "b,0,3,-1e300\n", 'line 6: value: got "-1e300"; allowed: >= -1e+75'),
    (GOOD + "b,0,2.0,1\n", "line 6: x: got 2 of run 0 of b twice; allowed: once"),
    (
        GOOD + "b,1,1,5\n",
        "x: run 1 of b has 1 row, run 0 has 2, and only one of them has x = 2; allowed: equal x in all runs",
    ),
    ('label,run,x,value\n"a,0,1,2\n', "cannot be read (unexpected end of data); allowed: CSV"),
)


class TestCurveFiles:
    def test_a_mistake_is_one_line_and_writes_nothing(self, here, refusal):
        for content, told in MISTAKES:
            (here / "other.csv").write_text(content)
            assert refusal("compare --csv other.csv").startswith(f"other.csv: {told}")
        for content in (b"\xff\xfe\x00label", b"label,run,x,value\na,0,1,\xff\n"):
            (here / "x.csv").write_bytes(content)
            with pytest.raises(ResultsError, match="cannot be read|unknown column"):
                read_curves(here / "x.csv")

    def test_a_single_method_has_scores_and_no_comparison(self, tmp_path):
        (tmp_path / "x.csv").write_text("label,run,x,value\na,0,1,0.5\na,1,1,2.5\n")
        page = compare([], [tmp_path / "x.csv"], tmp_path / "out").read_text()
        assert "1 method (a) of 1 source" in page and ">1.5<" in re.sub(r"\s", "", page)
        assert "P(better" not in page and "difference from" not in page

    def test_rows_and_columns_may_have_any_order(self, tmp_path):
        (tmp_path / "x.csv").write_text(
            "\ufeffvalue, x, run, label, task\n3,2,1,b,t\n\n1,1,1,b,t\n7,1,0,b,t\n8,2,0,b,t\n",
            encoding="utf-8",
        )
        (rows,) = read_curves(tmp_path / "x.csv")
        assert (rows.label, rows.task) == ("b", "t")
        assert {run: (x.tolist(), values.tolist()) for run, (x, values) in rows.runs.items()} == {
            0: ([1, 2], [7, 8]),
            1: ([1, 2], [1, 3]),
        }


def methods_of(episodes, measure, lengths=None, success=None):
    """Methods of returns `[runs, episodes]` by name, NaN where a run had no such episode.

    `success` are the runs that a first success ended.
    """
    runs = {name: {"success": np.zeros(len(values), bool)} for name, values in episodes.items()}
    for name, ended in (success or {}).items():
        runs[name]["success"][ended] = True
    results = in_memory(runs, episodes=episodes, stop="first-success" if success else "never")
    rows = results.episodes
    rows["return"] = rows.pop("value")
    rows["length"] = np.ones(rows["run"].size) if lengths is None else lengths
    return scored(of_folder(results, measure), measure)


def curves_of(path, runs, measure):
    """Methods of curves by label and run, pairs of places and values, scored."""
    rows = [
        f"{label},{run},{x},{value}"
        for label, each in runs.items()
        for run, pair in enumerate(each)
        for x, value in zip(*pair, strict=True)
    ]
    path.write_text("\n".join(["label,run,x,value", *rows]))
    return scored(of_file(path, read_curves(path), measure, ""), measure)


class TestMethods:
    def test_a_run_that_ended_scores_its_own_last_values_and_is_named_unless_it_succeeded(self):
        values = np.arange(40.0).reshape(2, 20)
        values[1, 10:] = np.nan
        (each,) = methods_of({"a": values}, EPISODES)
        assert each.scores.tolist() == [18.5, 29.0] and each.cut_off == [1]
        for measure in (EPISODES, STEPS, replace(EPISODES, options=Options(last=3))):
            (each,) = methods_of({"a": values}, measure, success={"a": [1]})
            assert each.scores[1] == 29.0 and not each.cut_off
            assert each.curve.values[1, 9:].tolist() == [29.0] * 11

    def test_scores_of_different_budgets_are_taken_at_the_largest_that_all_have(self, tmp_path):
        """Two equal curves, one of which goes on, are not different, by step and by episode."""
        x = np.arange(100, 100_001, 100)
        runs = [(x, np.sqrt(x) + run) for run in range(3)]
        short = [(x[:50], values[:50]) for x, values in runs]
        for measure in (
            EPISODES,
            STEPS,
            replace(STEPS, options=Options(last=7)),
            replace(STEPS, options=Options(at=2000)),
        ):
            a, b = curves_of(tmp_path / "x.csv", {"a": short, "b": runs}, measure)
            assert a.scores.tolist() == b.scores.tolist()
            assert (a.budget, b.budget, a.at) == (5000, 100_000, measure.options.at or 5000)
            assert a.curve.x[-1] == 5000 and b.curve.x[-1] == 100_000
            assert tables.difference(b, a).estimate == 0
        whole = [scored([each], STEPS)[0].scores for each in (a, b)]
        assert whole[1].min() > 4 * whole[0].max()  # at their own ends they are

    def test_the_last_values_are_those_that_a_run_logged(self, tmp_path):
        random = np.random.default_rng(3)
        runs = [
            (np.cumsum(random.integers(80, 200, size)), np.round(random.normal(size=size), 3))
            for size in (18, 13, 15)
        ]
        a, b = curves_of(
            tmp_path / "x.csv", {"a": runs, "b": runs[:1]}, replace(STEPS, options=Options(last=3))
        )
        assert a.scores == pytest.approx([values[-3:].mean() for _, values in runs])
        assert b.scores == pytest.approx(a.scores[:1]) and a.cut_off == [1, 2]

    def test_a_run_that_ends_within_its_own_interval_of_the_budget_was_not_cut_off(self, tmp_path):
        """Episodes end at other steps in every run; none of run 0 would have ended by step 1,000."""
        runs = [(np.array([200, 550, 950]), np.ones(3)), (np.array([400, 1000]), np.ones(2))]
        runs.append((np.array([100, 200, 900]), np.ones(3)))
        runs.append((np.array([100, 200]), np.ones(2)))
        (each,) = curves_of(tmp_path / "x.csv", {"a": runs}, STEPS)
        assert each.at == 1000 and each.cut_off == [3]

    def test_methods_whose_runs_all_succeeded_have_every_budget(self):
        values = np.ones((3, 30))
        values[:, 6:] = np.nan
        results = methods_of(
            {"a": values, "b": np.ones((3, 30)), "c": values}, STEPS, success={"a": [0, 1, 2], "c": [0, 1]}
        )
        assert [each.budget for each in results] == [np.inf, 30, 6]
        assert {each.at for each in results} == {6}
        both = scored([results[0], replace(results[0], has_nan=results[0].has_nan)], STEPS)
        assert both[0].at == 6 and both[0].scores.tolist() == [1, 1, 1]

    def test_a_run_without_a_value_up_to_the_budget_has_no_score_and_is_named(self, tmp_path):
        runs = {"a": [([10, 20], [1, 2])], "b": [([30, 40], [3, 4]), ([15, 40], [3, 4])]}
        a, b = curves_of(tmp_path / "x.csv", runs, STEPS)
        assert np.isnan(b.scores).tolist() == [True, False] and b.without_value == [0]
        (task,) = tasks_of([a, b], STEPS, None)
        assert "Without a value up to it: run 0 of b." in tables.scores(task, STEPS).caption

    def test_planning_of_other_time_limits_is_compared_at_the_shorter_one(self, tmp_path):
        """Runs that parked or left the domain are over; the others had 15 steps of 50 in `long`."""
        measure = Measure("accumulated_reward", False, "planning", "step")
        folders = [write_results(tmp_path / name, runs=20, recorded=0) for name in ("short", "long")]
        edit_manifest(
            folders[1], lambda m: [p["config"]["problem"].update(max_steps=50) for p in m["points"]]
        )
        found = [of_folder(load(folder), measure)[-1] for folder in folders]
        assert [each.budget for each in found] == [15, np.inf]
        at_10 = scored(found, replace(measure, options=Options(at=10)))
        steps = load(folders[0]).by_step(found[0].point, "accumulated_reward")
        assert at_10[0].scores.tolist() == steps[:, 10].tolist()

    def test_a_value_holds_from_the_end_of_its_episode(self):
        """Episodes of 2 and 3 steps in run 0, of 1 and 4 in run 1: both have made 5 steps."""
        values = np.array([[1.0, 2.0], [3.0, 4.0]])
        (each,) = methods_of({"a": values}, STEPS, np.array([2, 3, 1, 4]))
        assert each.curve.x.tolist() == [1, 2, 3, 4, 5]
        np.testing.assert_array_equal(each.curve.values, [[np.nan, 1, 1, 1, 2], [3, 3, 3, 3, 4]])

    def test_runs_are_paired_by_seed_and_index(self, tmp_path):
        folders = [
            write_learning(tmp_path / name, runs=runs) for name, runs in (("a", 6), ("b", 6), ("c", 5))
        ]
        edit_manifest(folders[1], lambda manifest: manifest.update(seed=1))
        a, b, c = (of_folder(load(folder), EPISODES)[0] for folder in folders)
        again = of_folder(load(folders[0]), EPISODES)[1]
        rows = Rows("x", "", {run: (np.ones(1), np.ones(1)) for run in range(6)})
        (x,) = of_file(tmp_path / "x.csv", [rows], EPISODES, "t")
        assert a.is_paired_with(again) and again.is_paired_with(a)
        assert not any(a.is_paired_with(other) for other in (b, c, x))

    def test_equal_names_are_told_apart_by_their_sources(self, tmp_path):
        folders = [write_learning(tmp_path / name, runs=3) for name in ("a", "b")]
        found = named([each for folder in folders for each in of_folder(load(folder), EPISODES)])
        assert [each.name for each in found][::3] == ["emu-q (a)", "emu-q (b)"]
        assert [each.curve.point.name for each in scored(found, EPISODES)] == [each.name for each in found]

    def test_a_run_with_a_nan_has_no_score(self, tmp_path):
        folder = write_learning(tmp_path / "a", runs=3)
        results = load(folder)
        results.runs["nans"] = np.where(results.runs["run"] == 1, 2, 0)
        scores = scored(of_folder(results, EPISODES), EPISODES)[0].scores
        assert np.isnan(scores).tolist() == [False, True, False]

    def test_a_run_that_never_reached_the_goal_counts_with_its_end(self, tmp_path):
        measure = Measure("episodes_to_goal", True, "learning", "episode")
        _, rff_q, epsilon_greedy = found = of_folder(load(write_learning(tmp_path / "a", runs=3)), measure)
        assert scored([rff_q, epsilon_greedy], measure)[0].scores.tolist() == [12, 20, 12]
        assert scored(found, measure)[2].scores.tolist() == [20, 20, 20]

    def test_times_to_the_goal_are_compared_up_to_one_budget(self, tmp_path):
        """The same learner with 20 and with 8 episodes; it reaches the goal at 12 in two of three runs."""
        measure = Measure("episodes_to_goal", True, "learning", "episode")
        folders = [write_learning(tmp_path / f"{n}", runs=3, episodes=n) for n in (20, 8)]
        results = load(folders[1])
        results.runs["episodes_to_goal"] = np.where(
            results.runs["episodes_to_goal"] > 8, np.nan, results.runs["episodes_to_goal"]
        )
        long, short = of_folder(load(folders[0]), measure)[1], of_folder(results, measure)[1]
        assert [each.scores.tolist() for each in scored([long, short], measure)] == [[8, 8, 8]] * 2


class TestTables:
    def test_a_difference_of_paired_runs_is_that_of_their_differences(self, tmp_path):
        results = load(write_results(tmp_path / "a", runs=20))
        measure = Measure("accumulated_reward", False, "planning", "step")
        found = scored(of_folder(results, measure), measure)
        returns = results.paired(results.points[:2], "return")
        assert found[0].scores == pytest.approx(returns[:, 0])
        interval = tables.difference(found[1], found[0])
        assert interval == statistics.mean_interval(found[1].scores - found[0].scores)

    def test_a_difference_of_other_runs_is_welchs(self, tmp_path):
        folders = [write_learning(tmp_path / name, runs=runs) for name, runs in (("a", 6), ("b", 9))]
        measure = Measure("steps_to_goal", True, "learning", "episode")
        a, b = scored([of_folder(load(folder), measure)[0] for folder in folders], measure)
        test = stats.ttest_ind(b.scores, a.scores, equal_var=False).confidence_interval()
        interval = tables.difference(b, a)
        assert (interval.low, interval.high) == pytest.approx((test.low, test.high))

    def test_times_have_the_intervals_of_the_report(self, tmp_path):
        results = load(write_learning(tmp_path / "a", runs=8))
        for column in ("episodes_to_goal", "steps_to_goal"):
            measure = Measure(column, True, "learning", "episode")
            found = scored(of_folder(results, measure), measure)
            means = {each.point.name: each.mean for each in ranking(results, measure)}
            report = report_tables.outcomes(results)
            place = report.headings.index(f"{column.replace('_', ' ')}, all runs")
            for each, (name, cells) in zip(found, report.rows, strict=True):
                assert each.mean == means[name] and each.mean.in_words()[1] == cells[place].interval

    def test_scores_that_are_0_or_1_are_shares(self, tmp_path):
        measure = Measure("success", False, "learning", "episode", Options(last=1))
        results = load(write_learning(tmp_path / "a", runs=10, tests=0))
        *_, rff_q, none = found = scored(of_folder(results, measure), measure)
        (task,) = tasks_of(found, measure, None)
        cells = [tables.scores(task, measure).rows[place][1] for place in (1, 2)]
        assert [cells[0][1].text, cells[1][1].text] == ["90.0%", "0.0%"]
        assert cells[1][1].interval == "[0.0%, 27.8%]" and none.mean.high == pytest.approx(0.278, abs=1e-3)
        both = np.stack([none.scores, rff_q.scores], axis=1)
        assert tables.difference(none, rff_q) == statistics.paired_shares(both, [1, -1])
        assert tables.difference(none, replace(rff_q, seed=1)) == statistics.share_difference(0, 10, 9, 10)

    def test_bounds_of_mean_rates_are_possible_rates(self, tmp_path):
        measure = Measure("success", False, "learning", "step", Options(last=2))
        runs = {"a": [([1, 2], pair) for pair in ([0, 1], [1, 1], [1, 1])], "b": [([1, 2], [0, 0])] * 3}
        a, b = curves_of(tmp_path / "x.csv", runs, measure)
        assert a.scores.tolist() == [0.5, 1, 1] and not a.is_share and b.is_share
        assert a.mean.high == 1 and b.mean == statistics.share_interval(b.scores)
        assert tables.difference(b, a).low == -1
        percent = {"a": [([1], [50]), ([1], [100])]}
        assert curves_of(tmp_path / "x.csv", percent, measure)[0].mean.high > 100

    def test_less_is_better_with_a_minus_sign(self, tmp_path):
        measure = Measure("episodes", True, "learning", "episode")
        found = scored(of_folder(load(write_learning(tmp_path / "a", runs=6)), measure), measure)
        pair = [(found[0], found[1])]
        less = tables.improvement(pair, Measure("x", True, "learning", "episode"))
        more = tables.improvement(pair, Measure("x", False, "learning", "episode"))
        assert less.estimate + more.estimate == pytest.approx(1.0)

    def test_only_settings_that_differ_are_listed(self, tmp_path):
        folders = [write_learning(tmp_path / name, runs=3) for name in ("a", "b")]
        edit_manifest(folders[1], lambda manifest: manifest.update(seed=9))
        found = named([each for folder in folders for each in of_folder(load(folder), EPISODES)])
        rows = dict(tables.settings(found).rows)
        assert set(rows) == {"learner.kind", "seed"}
        assert [cell.text for cell in rows["seed"]] == ["0", "0", "0", "9", "9", "9"]

    def test_methods_in_different_worlds_are_compared_with_a_caution(self, tmp_path):
        folders = [write_learning(tmp_path / name, runs=3) for name in ("a", "b")]
        found = named([each for folder in folders for each in of_folder(load(folder), EPISODES)])
        alike = tasks_of(found, EPISODES, None)
        assert tables.differing_worlds(alike) == []

        def change(manifest):
            for point in manifest["points"]:
                point["config"]["env"] = {**point["config"]["env"], "reward": "classic"}

        edit_manifest(folders[1], change)
        text = Page(compare(folders, [], tmp_path / "unlike").read_text()).text
        assert "The methods differ in env.reward: their scores may not be comparable." in text

    def test_results_of_one_sweep_that_were_compiled_with_different_choices_are_named(self, tmp_path):
        folders = [write_learning(tmp_path / name, runs=3) for name in ("a", "b")]
        programs = {"0-8-advance": "1234", "0-8-fill": "5678"}
        for folder in folders:
            edit_manifest(folder, lambda manifest: manifest.update(config_hash="same", programs=programs))
        sentence = "compiled with different choices of kernels"
        text = Page(compare(folders, [], tmp_path / "alike").read_text()).text
        assert sentence not in text and text.count("2 programs, ") == 2
        edit_manifest(folders[1], lambda manifest: manifest["programs"].update({"0-8-fill": "9999"}))
        text = Page(compare(folders, [], tmp_path / "unlike").read_text()).text
        assert sentence in text and str(folders[0]) in text
        edit_manifest(folders[1], lambda manifest: manifest.update(config_hash="other"))
        assert sentence not in Page(compare(folders, [], tmp_path / "others").read_text()).text


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    write_learning(folder / "a", runs=8)
    (folder / "x.csv").write_text(
        "label,run,x,value\n" + "".join(f"dqn,{r},{x},{x / 20 - r}\n" for r in range(4) for x in range(1, 21))
    )
    out, command = folder / "out", "bojax compare a --csv x.csv"
    assert compare([folder / "a"], [folder / "x.csv"], out, command=command) == out / "comparison.html"
    return folder / "out"


@pytest.mark.parametrize("sign", ["", "-"])
def test_less_of_a_time_is_better_with_and_without_a_minus_sign(tmp_path, sign):
    results = load(write_learning(tmp_path / "a", runs=3, episodes=3))
    measure = measured_by([results], Options(sign + "steps_to_goal"))
    assert (measure.column, measure.is_least) == ("steps_to_goal", True)
    assert measured_by([results], Options(sign + "success")).is_least == bool(sign)


class TestPage:
    def test_it_has_every_method_and_loads_nothing(self, out):
        page = Page((out / "comparison.html").read_text(encoding="utf-8"))
        for name in (
            "emu-q",
            "rff-q",
            "epsilon-greedy",
            "dqn",
            "IQM",
            "paired",
            "bojax compare a --csv x.csv",
        ):
            assert name in page.text
        assert page.loaded and all(each.startswith(("data:", "#")) for each in page.loaded)
        assert all(image["alt"] for image in page.all("img"))

    def test_the_table_of_scores_can_be_sorted_by_every_column(self, out):
        text = (out / "comparison.html").read_text(encoding="utf-8")
        (table,) = re.findall(r'<table class="sortable">.*?</table>', text, re.DOTALL)
        rows = [re.findall(r'data-sort="([^"]*)"', row) for row in table.split("<tr>")[2:]]
        assert [row[0] for row in rows] == ["emu-q", "rff-q", "epsilon-greedy", "dqn"]
        assert [float(row[1]) for row in rows] == [8, 8, 8, 4]
        assert float(rows[3][2]) == pytest.approx(np.mean([19.5 / 20 - run for run in range(4)]))
        assert rows[0][4:] == ["", "", ""]  # the reference
        assert all(map(float, rows[1][4:6])) and rows[1][6] == "paired"
        assert text.count("<script>") == 1

    def test_it_states_the_rule_and_the_budgets_beside_the_scores(self, tmp_path):
        ends = {("a", 0): 5, ("a", 1): 5, ("b", 0): 20, ("b", 1): 2}
        rows = [f"{label},{run},{x},1" for (label, run), end in ends.items() for x in range(1, end + 1)]
        (tmp_path / "x.csv").write_text("\n".join(["label,run,x,value", *rows]))
        for at, rule in ((None, "the largest that all methods have"), (4, "the one of --at")):
            page = compare([], [tmp_path / "x.csv"], tmp_path / f"out-{at}", Options(axis="step", at=at))
            text = page.read_text(encoding="utf-8")
            assert f"up to the budget. The budget is {rule}." in Page(text).text
            assert f"The budget of all scores is step {at or 5}. Cut off before it, without a succ" in text
            assert "so that their last values count: run 1 of b." in text
            cells = re.findall(r'data-heading="(budget \(steps\)|runs cut off)".*?<span>(.*?)</span>', text)
            budgets = ["4 of 5", "4 of 20"] if at else ["5", "5 of 20"]
            assert [cell for _, cell in cells] == [budgets[0], "0", budgets[1], "1"]

    def test_several_tasks_have_their_own_figures_and_a_table_over_all(self, tmp_path):
        lines = ["label,task,run,x,value"]
        for task, scale in (("easy", 1), ("very/hard", 100)):
            for label, score in (("a", 1), ("b", 2)):
                lines += [f"{label},{task},{run},1,{scale * (score + 0.1 * run)}" for run in range(5)]
        (tmp_path / "x.csv").write_text("\n".join(lines))
        page = Page(compare([], [tmp_path / "x.csv"], tmp_path / "out").read_text(encoding="utf-8"))
        assert "All tasks" in page.text and "P(better than a)" in page.text
        names = {path.stem for path in (tmp_path / "out" / "figures").iterdir()}
        assert names == {"curves-1-easy", "curves-2-very-hard", "scores-1-easy", "scores-2-very-hard"}
        found = of_file(tmp_path / "x.csv", read_curves(tmp_path / "x.csv"), EPISODES, "")
        overall = dict(tables.overall(tasks_of(found, EPISODES, "a"), "a", EPISODES).rows)
        # Runs of b are 1 above those of a in units of the difference of the means.
        assert overall["b"][1].text == "100.0%"
        assert [overall[name][0].text for name in "ab"] == ["0.00", "1.00"]

    def test_shares_of_episodes_are_no_successes_of_runs(self, tmp_path):
        for values, band in (((0, 1), "Wilson"), ((0.25, 0.5), "Student&#39;s t")):
            rows = [f"{label},{run},1,{values[run]}" for label in "ab" for run in (0, 1)]
            (tmp_path / "x.csv").write_text("\n".join(["label,run,x,value", *rows]))
            page = compare([], [tmp_path / "x.csv"], tmp_path / band[:2], Options("success"))
            text = page.read_text(encoding="utf-8")
            caption = re.findall(r"<figcaption>(.*?)</figcaption>", text, re.DOTALL)[0]
            assert f"95% bands ({band})" in caption

    def test_curves_of_planning_may_begin_at_step_1(self, tmp_path):
        write_results(tmp_path / "parking", runs=4, recorded=1)
        (tmp_path / "x.csv").write_text("label,run,x,value\nother,0,1,5\nother,0,9,6\nother,1,1,5\n")
        page = compare([tmp_path / "parking"], [tmp_path / "x.csv"], tmp_path / "out")
        curves, _ = Page(page.read_text(encoding="utf-8")).all("img")
        assert "other 5.00 and 5.50" in curves["alt"]  # run 1 keeps its last value

    def test_a_run_of_planning_with_a_nan_is_left_out_and_counted(self, tmp_path):
        folder = write_results(tmp_path / "parking", runs=4, recorded=1)
        set_column(folder, "nans", np.arange(4 * 5) == 0)
        page = Page(compare([folder], [], tmp_path / "out").read_text(encoding="utf-8"))
        assert "Left out: 1 run with a non-finite value." in page.text and "in 1 run" in page.text


WRONG_WORDS = """\
car car
=> bojax compare: got car twice; allowed: distinct sources
nowhere
=> nowhere: no such results folder
empty
=> empty: not a results folder (no manifest.json); allowed: a results folder; curves of other
car --csv nowhere.csv
=> nowhere.csv: cannot be read: No such file or directory
car --csv empty
=> empty: has no curves; allowed: a folder with *monitor.csv, progress.csv, evaluations.npz or
car parking
=> parking: got results of planning, car has results of learning; allowed
car newer
=> newer: this version of bojax cannot read the settings of emu-q (episodes: got
car --metric retrun
=> car: unknown metric retrun; allowed:
parking --metric=-rmse
=> parking: unknown metric rmse; allowed:
car --metric steps --csv good.csv
=> good.csv: has curves, but steps has one value per run
car --x time
=> --x: got time; allowed: episode, step (see: bojax compare --help)
parking --x episode
=> --x: got episode; allowed of planning: step
car --phase test
=> car: has no test episodes; allowed: --phase train
car --last 0
=> --last: got 0; allowed: >= 1
car --at 0
=> --at: got 0; allowed: >= 1
car --at 21
=> --at: got 21; emu-q has 20 episodes; allowed: <= 20
car --at 5 --metric success --csv late.csv
=> --at: got 5; a run of c has its
car --at 5 --metric=-steps
=> --at: got 5; steps has one value per run, at its end
car --metric ''
=> --metric: got ""; allowed: a column, such as return or -rmse
car --metric=-
=> --metric: got "-"; allowed: a column, such as return or -rmse
car --reference emuq
=> --reference: got emuq; allowed: emu-q, epsilon-greedy, rff-q; did
car --out parking
=> parking: the folder is not empty; give another --out
car --out good.csv
=> good.csv: is not a folder; allowed: a new or empty folder
"""


class TestMistakes:
    @pytest.fixture
    def here(self, here):
        write_learning(here / "car", runs=3, tests=0)
        write_results(here / "parking", runs=4, recorded=0)
        (here / "good.csv").write_text(GOOD)
        (here / "late.csv").write_text("label,run,x,value\nc,0,8,1\nc,0,9,1\n")
        (here / "empty").mkdir()
        write_learning(here / "newer", runs=3)
        edit_manifest(here / "newer", lambda m: m["points"][0]["config"].update(episodes="many"))
        return here

    def test_a_mistake_is_one_line_and_writes_nothing(self, here, refusal):
        assert refusal("compare").startswith(
            "bojax compare: got none; allowed: results folders or --csv files"
        )
        for words, message in cases(WRONG_WORDS):
            assert refusal(f"compare {words}").startswith(message)

    def test_a_good_command_writes_one_page(self, here, capsys):
        assert main(["compare", "car", "--csv", "good.csv", "--metric=-return", "--out", "out"]) == 0
        assert capsys.readouterr().out == "out/comparison.html\n"


def test_environments_of_other_libraries_are_tasks_of_their_own():
    worlds = [
        Gymnasium(id="MountainCarContinuous-v0"),
        Gymnasium(id="my_pend:Rail-v0"),
        Brax(name="reacher"),
        MountainCar(),
    ]
    tasks = ["MountainCarContinuous-v0", "my_pend:Rail-v0", "reacher", "mountain-car"]
    assert [task_of(world) for world in worlds] == tasks
