"""The report of a learning sweep: tables that never hide a failure, figures over episodes and numbers."""

from dataclasses import replace

import numpy as np
import pytest

from bojax.claims.samples import by_episode
from bojax.config.claims import Window
from bojax.report import tables
from bojax.report.baseline import baselines
from bojax.report.build import build_report
from bojax.report.columns import Columns
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.exporting import exported
from bojax.report.figures import draw
from bojax.report.figures.curves import limit, rolling_mean
from bojax.report.figures.sweeps import curves_over, nearest_law, swept_panel
from bojax.report.source import load
from bojax.report.style import settings
from bojax.report.text import MISSING
from bojax.results.baseline import COLUMNS, FILE
from bojax.results.store import write_table
from bojax.results.tables import to_arrow
from tests.report.synthetic import edit_manifest, in_memory, write_learning, write_results
from tests.report.test_report import Page

LEARNING = ["learning-curves", "success-episodes", "solved-episodes", "steps-to-goal", "value-maps"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    report = {"thesis": {"emu-q": {"success": "100%", "episodes_to_goal": "2.95 (0.38)"}}, "best_return": 1.0}
    folder = write_learning(tmp_path_factory.mktemp("learning") / "results", report=report)
    build_report(folder)
    return folder


@pytest.fixture(scope="module")
def chains(tmp_path_factory):
    return load(
        write_learning(tmp_path_factory.mktemp("chains") / "results", lengths=(2, 5, 10, 20), tests=0)
    )


def drawn(name, results):
    with settings():
        return draw(name, results)


def heights(axes, place=0):
    """Values of a curve of a panel."""
    return np.asarray(axes.get_lines()[place].get_ydata(), dtype=np.float64)


class TestTable:
    @pytest.fixture
    def cells(self, folder):
        table = tables.outcomes(load(folder))
        return {name: dict(zip(table.headings, cells, strict=True)) for name, cells in table.rows}

    def test_means_are_of_the_runs_that_got_there_with_their_deviation(self, cells):
        cell = cells["emu-q"]["episodes to goal, runs that reached it"]
        assert cell.text == "3.50 (0.509)" and cell.thesis == "2.95 (0.38)"
        cell = cells["rff-q"]["episodes to goal, runs that reached it"]
        assert cell.text.startswith("12.48 (") and cell.interval.endswith("], 29 of 30")

    def test_those_that_never_did_are_counted_to_their_end_in_a_bound(self, cells):
        assert cells["emu-q"]["episodes to goal, all runs"].text == "3.50"
        cell = cells["rff-q"]["episodes to goal, all runs"]
        assert cell.text.startswith("≥ 12.7")  # (29 runs of 12 or 13 and one of 20) / 30

    def test_no_bound_is_beyond_the_longest_run(self):
        cell = tables.censored_cell(np.array([1.0, 2.0, np.nan]), np.full(3, 5000.0))
        assert (cell.text, cell.interval) == ("≥ 1,668", "[1, 5,000]")

    def test_what_nobody_reached_is_no_number(self, cells):
        cell = cells["epsilon-greedy"]["episodes to goal, runs that reached it"]
        assert (cell.text, cell.interval) == ("never", "0 of 30")
        cell = cells["epsilon-greedy"]["episodes to target, runs that reached it"]
        assert (cell.text, cell.interval) == ("never", "0 of 30")
        assert cells["epsilon-greedy"]["episodes to target, all runs"].text == "≥ 20"
        assert cells["epsilon-greedy"]["target reached"].text == "0.0%"
        assert cells["epsilon-greedy"]["return after target"].text == "never"

    def test_a_column_of_one_learner_is_empty_for_the_others(self):
        runs = {
            "vime": {"iterations": np.array([3.0, 5.0]), "nans": np.array([0, 0])},
            "emu-q": {"iterations": np.array([np.nan, np.nan]), "nans": np.array([0, 0])},
            "broken-once": {"iterations": np.array([np.nan, np.nan]), "nans": np.array([1, 0])},
            "broken": {"iterations": np.array([np.nan, np.nan]), "nans": np.array([1, 1])},
        }
        table = tables.outcomes(in_memory(runs, episodes={name: np.zeros((2, 1)) for name in runs}))
        place = table.headings.index("iterations")
        texts = [cells[place].text for _, cells in table.rows]
        assert texts == ["4", MISSING, MISSING, "NaN"]

    def test_measures_of_planning_are_not_there(self, cells):
        assert not [heading for heading in cells["emu-q"] if "step 6" in heading or "exit" in heading]


class TestPage:
    def test_it_draws_what_learning_has_and_nothing_of_planning(self, folder):
        names = {path.stem for path in (folder / "figures").iterdir()}
        assert names == {*LEARNING, "returns"}

    def test_it_says_what_its_numbers_are(self, folder):
        text = Page((folder / "report.html").read_text()).text
        assert "3 learners (emu-q, rff-q and epsilon-greedy) in the environment mountain-car" in text
        assert "30 runs each of up to 20 episodes" in text
        assert "environment steps per second" in text and "search iterations" not in text
        assert "2,500" in text  # 5,000 steps in 2 s
        assert "Return of every run's last training episode" in text
        assert "thesis 2.95 (0.38)" in text

    def test_claims_on_episodes_are_judged_and_shown(self, tmp_path):
        window = {"from": 11, "to": 20, "phase": "test"}
        test = {"kind": "order", "column": "return", "window": window, "greater": ["emu-q", "epsilon-greedy"]}
        printed = {"kind": "agrees", "label": "emu-q", "column": "episodes_to_goal", "runs": 20}
        claims = [
            {"id": "a", "source": "s", "claim": "higher", "thesis": None, "test": test},
            {
                "id": "b",
                "source": "s",
                "claim": "as printed",
                "thesis": "3.5 (0.5)",
                "test": {**printed, "mean": 3.5, "sd": 0.5},
            },
        ]
        folder = write_learning(tmp_path / "results", report={"figures": ["returns"]}, claims=claims)
        build_report(folder)
        text = Page((folder / "report.html").read_text()).text
        assert text.count("✓ reproduced") == 2
        # The interval is that of the difference, and does not stand beside our mean.
        assert "episodes_to_goal of emu-q − published" in text


class TestCurves:
    def test_a_curve_is_the_mean_over_runs_of_each_episode(self, folder):
        results = load(folder)
        axes, tests = drawn("learning-curves", results).figure.axes
        np.testing.assert_array_equal(np.asarray(axes.get_lines()[0].get_xdata()), np.arange(1, 21))
        # All runs fail in episodes 1 and 2, half succeed in episode 3.
        np.testing.assert_allclose(heights(axes)[:5], [-1, -1, 0, 1, 1])
        assert tests.get_ylabel() == "return of tests"

    def test_a_rolling_mean_is_drawn_only_if_asked_for_and_said(self, tmp_path):
        folder = write_learning(tmp_path / "results", tests=0, report={"rolling": 2})
        drawing = drawn("learning-curves", load(folder))
        np.testing.assert_allclose(heights(drawing.figure.axes[0])[:5], [-1, -1, -0.5, 0.5, 1])
        assert "its mean over the last 2 episodes" in drawing.caption
        edit_manifest(folder, lambda manifest: manifest.update(report={}))
        assert "over the last" not in drawn("learning-curves", load(folder)).caption

    def test_a_rolling_mean_is_of_the_episodes_that_are_there(self):
        values = np.array([[1.0, 3.0, 5.0, np.nan]])
        np.testing.assert_array_equal(rolling_mean(values, 2), [[1.0, 2.0, 4.0, np.nan]])

    def test_an_early_disaster_does_not_flatten_the_rest(self, folder):
        results = load(folder)
        bad = (results.episodes["episode"] == 1) & (results.episodes["phase"] == "train")
        results.episodes["return"] = np.where(bad, -1000.0, results.episodes["return"])
        drawing = drawn("learning-curves", results)
        assert drawing.figure.axes[0].get_ylim()[0] > -10
        assert "Extreme values lie beyond the axis." in drawing.caption

    def test_the_last_values_are_no_extremes(self, folder):
        few = np.repeat([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 1.0, 0.0, 1.0]], [6, 2], axis=0)
        jump = np.concatenate([np.full(60, -1200.0), np.full(39, -900.0), [-300.0]])[None]
        for returns in (few, jump):
            panel = Panel("return", "mean return", [Curve.numbered(load(folder).points[0], returns, first=1)])
            axes = Chart([panel], "episode").axes[0]
            assert not limit(axes, panel, [])
            assert axes.get_ylim()[1] >= returns[:, -1].mean()

    def test_steps_to_the_goal_are_those_of_successful_episodes(self, folder):
        above, below = drawn("steps-to-goal", load(folder)).figure.axes
        steps, shares = heights(above), heights(below)
        np.testing.assert_allclose(steps[:5], [np.nan, np.nan, 97, 96, 95])
        np.testing.assert_allclose(shares[:5], [0, 0, 0.5, 1, 1])

    def test_success_is_that_of_the_first_episode_at_the_goal(self, folder):
        (axes,) = drawn("success-episodes", load(folder)).figure.axes
        np.testing.assert_allclose(heights(axes)[:5], [0, 0, 0, 0.5, 1])
        np.testing.assert_allclose(heights(axes, 2), 0)

    def test_solved_episodes_add_up(self, folder):
        (axes,) = drawn("solved-episodes", load(folder)).figure.axes
        np.testing.assert_allclose(heights(axes)[:6], [0, 0, 0, 0.5, 1.5, 2.5])
        np.testing.assert_allclose(heights(axes, 2), 0)

    def test_what_stops_at_the_first_success_is_not_counted(self, folder):
        results = load(folder)
        first = results.episodes["episode"] == 3
        results.episodes["success"] = results.episodes["success"] & first
        with pytest.raises(FigureUnavailable, match="more than one episode"):
            drawn("solved-episodes", results)

    def test_maps_show_u_with_the_first_observation_to_the_right(self, folder):
        drawing = drawn("value-maps", load(folder))
        panels = [axes for axes in drawing.figure.axes if axes.images]
        assert [axes.get_title() for axes in panels[:3]] == ["episode 1", "episode 2", "episode 3"]
        image = np.asarray(panels[0].images[0].get_array())
        # U is least at 0.4 of the first axis and in the middle of the second.
        row, column = np.unravel_index(image.argmin(), image.shape)
        assert column == 4 and row in (5, 6)
        assert tuple(panels[0].images[0].get_extent()) == (-1.2, 0.6, -0.07, 0.07)
        assert len({axes.images[0].get_clim() for axes in panels}) == 1


class TestSweptNumber:
    def test_a_curve_is_one_setting_over_the_number(self, chains):
        curves = curves_over(chains, "env.length", "steps_to_goal")
        assert [curve.point.name for curve in curves] == ["emu-q", "rff-q", "epsilon-greedy"]
        np.testing.assert_array_equal(curves[0].x, [2, 5, 10, 20])
        np.testing.assert_allclose(curves[0].values.mean(axis=0), 3.5 * np.array([2, 5, 10, 20]))
        assert not curves[0].is_partial.any() and curves[1].is_partial.all()
        assert curves[0].limits == (1, [200] * 4)
        assert curves_over(chains, "env.length", "success")[0].limits == (0, 1)

    def test_the_nearest_law_is_drawn_and_told(self, chains):
        drawing = drawn("growth", chains)
        law = nearest_law(curves_over(chains, "env.length", "steps_to_goal")[0])
        assert law is not None and law.law == "linear" and float(law.b) == pytest.approx(3.5, rel=1e-6)
        assert "emu-q linear" in drawing.caption and "Hollow" in drawing.caption

    def test_any_column_can_be_drawn(self, chains):
        report = chains.report.model_copy(update={"column": "episodes_to_goal"})
        other = replace(chains, manifest=chains.manifest.model_copy(update={"report": report}))
        assert drawn("sweep-curve", other).figure.axes[0].get_ylabel() == "mean episodes to goal, all runs"

    def test_a_run_without_the_goal_counts_with_the_end_of_the_longest_run(self, chains):
        panel, _, name, _ = swept_panel(chains, to_the_end=True)
        assert name == "steps to goal, or to the end of the longest run,"
        longest = chains.runs["steps"].max()
        assert any(curve.is_partial.any() for curve in curves_over(chains, "env.length", "steps_to_goal"))
        for curve, own in zip(panel.curves, curves_over(chains, "env.length", "steps_to_goal"), strict=True):
            expected = np.where(np.isnan(own.values), longest, np.minimum(own.values, longest))
            np.testing.assert_array_equal(curve.values, expected)

    def test_published_values_are_lines_with_their_names(self, chains):
        report = chains.report.model_copy(update={"column": "episodes_to_goal", "lines": {"a paper": 7.25}})
        drawing = drawn(
            "sweep-curve", replace(chains, manifest=chains.manifest.model_copy(update={"report": report}))
        )
        axes = drawing.figure.axes[0]
        assert any(set(np.ravel(line.get_ydata())) == {7.25} for line in axes.lines)
        assert "a paper" in [text.get_text() for text in axes.texts]
        assert "Dashed: a paper (7.25)." in drawing.caption

    def test_without_a_number_there_is_no_such_figure(self, folder):
        with pytest.raises(FigureUnavailable, match="no number to draw over"):
            draw("sweep-curve", load(folder))


class TestRunsThatASuccessEnded:
    """Run 0 succeeded in episode 2 and was stopped; run 1 never did. A second point has fewer episodes."""

    @pytest.fixture
    def results(self):
        nan = np.nan
        success = {
            "a": np.array([[0, 1, nan, nan], [0, 0, 0, 0]]),
            "b": np.array([[1, nan, nan, nan], [0, 0, 0, nan]]),
        }
        runs = {
            name: {"success": np.array([True, False]), "episodes_to_goal": np.array([first, nan])}
            for name, first in (("a", 2.0), ("b", 1.0))
        }
        results = in_memory(runs, episodes=success, stop="first-success")
        rows = results.episodes
        rows["success"] = rows.pop("value")
        rows["return"], rows["length"] = rows["success"] - 1, 10 * rows["episode"]
        return results

    def test_they_keep_their_last_value_up_to_the_budget_of_their_point(self, results):
        curves = heights(drawn("learning-curves", results).figure.axes[0])
        np.testing.assert_array_equal(curves, [-1, -0.5, -0.5, -0.5])
        axes = drawn("learning-curves", results).figure.axes[0]
        np.testing.assert_array_equal(heights(axes, 1), [-0.5, -0.5, -0.5, np.nan])
        assert (
            "A run that its success ended keeps its last value." in drawn("learning-curves", results).caption
        )

    def test_so_does_the_share_of_episodes_at_the_goal(self, results):
        steps, share = drawn("steps-to-goal", results).figure.axes
        np.testing.assert_array_equal(heights(share), [0, 0.5, 0.5, 0.5])
        np.testing.assert_array_equal(heights(steps), [np.nan, 20, 20, 20])

    def test_the_share_of_runs_at_the_goal_ends_with_the_budget(self, results):
        (axes,) = drawn("success-episodes", results).figure.axes
        np.testing.assert_array_equal(heights(axes), [0, 0, 0.5, 0.5, 0.5])
        np.testing.assert_array_equal(heights(axes, 1), [0, 0.5, 0.5, 0.5, np.nan])

    def test_a_sum_over_episodes_does_not_count_the_kept_value_again(self, results):
        point = results.points[0]
        summed = results.by_episode(point, "success", is_summed=True)
        np.testing.assert_array_equal(summed, [[0, 1, 1, 1], [0, 0, 0, 0]])

    def test_exports_average_the_same_runs_at_every_episode(self, results):
        curves = {curve.name: curve for curve in exported(results)[0].curves}
        np.testing.assert_array_equal(curves["train/success"].mean, [0, 0.5, 0.5, 0.5])

    def test_windows_of_claims_from_the_start_have_the_kept_value(self, results):
        point, runs = results.points[0], np.arange(2)
        window = Window.model_validate({"from": 3, "to": 4})
        np.testing.assert_array_equal(by_episode(results, point, "success", window, runs), [[1, 1], [0, 0]])
        after = Window.model_validate({"from": 2, "to": 2, "counted_from": "first-success"})
        assert np.isnan(by_episode(results, point, "success", after, runs)).all()


def test_a_planner_has_no_curve_beyond_its_time_limit(tmp_path):
    """With a limit of 9 steps in one point, and runs that go on in the others."""
    results = load(write_results(tmp_path / "parking", runs=20, recorded=0))
    point = results.points[4]
    problem = point.problem.model_copy(update={"max_steps": 9})
    limited = replace(point, experiment=point.experiment.model_copy(update={"problem": problem}))
    is_kept = (results.steps["point"] != 4) | (results.steps["step"] <= 9)
    steps = Columns({key: column[is_kept] for key, column in results.steps.items()})
    runs = results.runs
    runs["steps"] = np.where(runs["point"] == 4, np.minimum(runs["steps"], 9), runs["steps"])
    results = replace(results, points=(*results.points[:4], limited))
    results.__dict__.update(steps=steps, runs=runs)
    for name in ("accumulated-reward", "success"):
        (axes,) = drawn(name, results).figure.axes
        known = np.isfinite(heights(axes, 4))
        assert known[:10].all() and not known[10:].any(), name
        assert np.isfinite(heights(axes)).all()


class TestBaseline:
    """Random actions of 6 runs and 20 episodes: held ones reach the goal in episode 3 of every other run."""

    @pytest.fixture
    def folder(self, tmp_path):
        folder = write_learning(tmp_path / "results")
        repeat, run, episode = (x.ravel() for x in np.meshgrid([1, 8], range(6), range(1, 21), indexing="ij"))
        success = (repeat == 8) & (run % 2 == 0) & (episode == 3)
        columns = {"action_repeat": repeat, "run": run, "episode": episode, "success": success}
        columns |= {"return": success.astype(float), "length": np.full(repeat.shape, 9)}
        write_table(folder / FILE, to_arrow(COLUMNS, columns))
        return folder

    def test_its_shares_are_drawn_beside_the_learners(self, folder):
        drawing = drawn("success-episodes", load(folder))
        *_, alone, held = drawing.figure.axes[0].get_lines()[:5]
        np.testing.assert_array_equal(alone.get_ydata(), 0.0)
        np.testing.assert_array_equal(held.get_ydata(), np.repeat([0.0, 0.5], [3, len(held.get_ydata()) - 3]))
        assert drawing.curves[-2:] == ["random actions", "random actions, held"]
        assert "Random actions learn nothing" in drawing.caption

    def test_its_returns_are_drawn_for_training_alone(self, folder):
        train, test = drawn("learning-curves", load(folder)).figure.axes
        np.testing.assert_array_equal(heights(train, 4), [0, 0, 0.5, *[0] * 17])
        assert len(test.get_lines()) == 4  # three learners, and the line at 0

    def test_the_last_return_of_a_run_that_its_first_success_ends_is_held(self, folder):
        results = load(folder)
        point = results.points[0]
        early = point.experiment.model_copy(update={"stop": "first-success"})
        points = (replace(point, experiment=early), *results.points[1:])
        _, held = baselines(replace(results, points=points))
        np.testing.assert_array_equal(held.returns[:, 1:4].T, [[0] * 6, [1, 0] * 3, [1, 0] * 3])
        np.testing.assert_array_equal(held.first, [3, np.nan] * 3)

    def test_other_folders_have_none(self, tmp_path):
        assert baselines(load(write_learning(tmp_path / "results"))) == []
