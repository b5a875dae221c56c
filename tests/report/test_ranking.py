"""Points in the order of a mean, the table of ranks, and the map of two swept numbers."""

import dataclasses
import re

import numpy as np
import pytest

from bojax.config.sweep import load_config
from bojax.config.sweep_file import Report
from bojax.report import statistics
from bojax.report.build import build_report
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.figures.grids import best_means, heat_map, settings
from bojax.report.ranking import Measure, best_of, config_of, measure_of, ranking, scored
from bojax.report.source import load
from bojax.report.tables import FEW_POINTS, Cell, ranked, ranking_gaps
from bojax.results.store import ResultsError
from tests.report.synthetic import edit_manifest, in_memory, write_learning, write_monitoring, write_results

DEPTHS, KAPPAS = (1, 2, 3, 4), (0.1, 1.0, 10.0, 100.0)
RETURN = Measure("return", is_least=False)


def grid(runs=30, **columns):
    """A grid whose mean return is -(depth - 3)^2 - (log10 kappa)^2, exactly the same noise at all points."""
    noise = np.random.default_rng(0).normal(size=runs)
    points, swept = {}, {}
    for depth in DEPTHS:
        for kappa in KAPPAS:
            mean = -((depth - 3.0) ** 2) - np.log10(kappa) ** 2
            points[f"{depth}, {kappa}"] = {"return": mean + noise - noise.mean(), "rmse": -mean + noise**2}
            swept[f"{depth}, {kappa}"] = {"label": "sbo", "planner.depth": depth, "planner.kappa": kappa}
    return swept_results({name: values | columns for name, values in points.items()}, swept)


def swept_results(runs, swept):
    """Results of points that are one variant."""
    results = in_memory(runs, swept=swept)
    points = tuple(dataclasses.replace(point, variant="sbo") for point in results.points)
    object.__setattr__(results, "points", points)
    return results


def swept_of(ranked):
    return ranked.point.swept["planner.depth"], ranked.point.swept["planner.kappa"]


def test_the_order_is_that_of_the_means():
    ranked = ranking(grid(), RETURN)
    assert swept_of(ranked[0]) == (3, 1.0) and len(ranked) == 16
    means = [each.mean.estimate for each in ranked]
    assert means == sorted(means, reverse=True)
    assert swept_of(best_of(grid(), Measure("rmse", is_least=True))) == (3, 1.0)
    assert swept_of(best_of(grid(), Measure("rmse", is_least=False)))[0] == 1


def test_differences_from_the_best_are_paired():
    first, *others = ranking(grid(), RETURN)
    assert (first.lag.estimate, first.lag.low, first.lag.high) == (0.0, 0.0, 0.0)
    for each in others:
        depth, kappa = swept_of(each)
        lag = (depth - 3.0) ** 2 + np.log10(kappa) ** 2
        # The noise is the same at both points, so that nothing of it is left.
        np.testing.assert_allclose([each.lag.estimate, each.lag.low, each.lag.high], lag, atol=1e-9)
        assert each.mean.high - each.mean.low > 0.3


def test_runs_that_only_one_point_has_do_not_enter_a_difference():
    results = grid()
    kept = ~((results.runs["point"] == 0) & (results.runs["run"] % 2 == 0))
    results.__dict__["runs"] = {name: values[kept] for name, values in results.runs.items()}
    first = next(each for each in ranking(results, RETURN) if each.point.index == 0)
    assert first.runs == 15
    np.testing.assert_allclose(first.lag.low, 4.0 + 1.0, atol=1e-9)


def test_a_point_with_a_nan_has_no_rank_and_ties_keep_their_order():
    results = grid()
    values = results.runs["return"]
    values[results.runs["point"] == 9] = values[results.runs["point"] == 8]
    values[3] = np.nan
    found = [each.point.index for each in ranking(results, RETURN)]
    assert 0 not in found and len(found) == 15
    assert found.index(8) + 1 == found.index(9)


def test_shares_have_the_interval_of_wilson():
    results = grid(success=np.arange(30) < 12)
    first = best_of(results, Measure("success", is_least=False))
    low, high = statistics.wilson(12, 30)
    assert (first.mean.estimate, first.mean.low, first.mean.high) == (0.4, float(low), float(high))
    assert scored(RETURN, first).startswith("mean return: 0.40, 95% interval [0.2")


def test_a_run_that_never_reaches_its_goal_counts_with_its_end(tmp_path):
    results = load(write_learning(tmp_path / "a"))
    measure = measure_of(results)
    assert measure == measure_of(results, "steps_to_goal") == Measure("steps_to_goal", is_least=True)
    labels = [each.point.label for each in ranking(results, measure)]
    assert labels == ["emu-q", "rff-q", "epsilon-greedy"]
    runs = results.runs_of(results.points[1])
    never = np.isnan(runs["steps_to_goal"].astype(float))
    found = measure.values(results, results.points[1])
    assert never.sum() == 1 and (found[never] == runs["steps"][never]).all()


def test_a_run_gains_nothing_by_ending_early_without_reaching_its_goal():
    """Point `a` reached the goal after 50 steps; the runs of `b` fell over and were done after 10."""
    results = in_memory(
        {
            "a": {"steps_to_goal": np.full(4, 50.0), "steps": np.full(4, 60)},
            "b": {"steps_to_goal": np.full(4, np.nan), "steps": np.full(4, 10)},
        }
    )
    ranked = ranking(results, Measure("steps_to_goal", is_least=True))
    assert [(each.point.name, each.mean.estimate) for each in ranked] == [("a", 50), ("b", 60)]


def test_an_unknown_column_is_refused_with_those_that_are_known():
    for by in ("rewrd", "label", "planner.depth", "seed", ""):
        with pytest.raises(ResultsError, match=f"unknown column {by}; allowed: return, rmse"):
            measure_of(grid(), by)


def test_learners_have_the_return_of_their_last_episode(tmp_path):
    results = load(write_learning(tmp_path / "car", runs=3, episodes=3))
    results.runs["steps_to_goal"][:] = np.nan
    assert measure_of(results) == Measure("last_return", is_least=False)
    with pytest.raises(ResultsError, match=r'unknown column return; .* did you mean "last_return"\?'):
        measure_of(results, "return")


def test_the_setting_of_the_report_decides_unless_another_column_is_asked_for(tmp_path):
    results = load(write_monitoring(tmp_path / "a", report={"rank_by": "-rmse"}))
    assert measure_of(results) == Measure("rmse", is_least=True)
    assert measure_of(results, "return") == Measure("return", is_least=False)
    assert ranking_gaps(results) == []
    edit_manifest(results.folder, lambda manifest: manifest["report"].update(rank_by="rsme"))
    (note,) = ranking_gaps(load(results.folder))
    assert "report.rank_by: runs.parquet: unknown column rsme; " in note and 'did you mean "rmse"' in note


def test_the_config_of_a_point_runs_with_another_seed(tmp_path):
    results = load(write_results(tmp_path / "a"))
    config = config_of(results, results.points[1])
    sweep = load_config(config)
    assert (sweep.seed, sweep.runs, sweep.points[0].label) == (1, 40, "sbo")
    assert sweep.points[0].config.planner.iterations == 300


def test_the_table_of_ranks_is_sorted_and_has_the_best_point_first():
    table = ranked(grid())
    assert table.headings == ["mean return", "behind the best", "planner.depth", "planner.kappa", "runs"]
    assert len(table.rows) == 16
    assert [cell.text for cell in table.rows[0][1]][2:] == ["3", "1", "30"]
    keys = [[cell.key for cell in cells] for _, cells in table.rows]
    assert [row[0] for row in keys] == sorted((row[0] for row in keys), reverse=True)
    assert [row[1] for row in keys] == sorted(row[1] for row in keys)


def test_without_common_runs_nothing_is_said_of_a_difference():
    results = grid()
    results.runs["run"] = results.runs["run"] + 1000 * (results.runs["point"] % 2)
    table = ranked(results)
    assert len(table.rows) == 16
    assert sum(cells[1] == Cell("–") for _, cells in table.rows) == 8


def test_few_points_need_no_table():
    names = [str(number) for number in range(FEW_POINTS)]
    assert ranked(in_memory({name: {"return": np.ones(3)} for name in names})) is None


def test_the_page_has_a_sortable_table_and_the_map(tmp_path):
    folder = write_learning(
        tmp_path / "a", runs=4, episodes=4, lengths=(5, 10, 15, 20, 25), report={"figures": ["settings"]}
    )
    page = build_report(folder).read_text()
    (table,) = re.findall(r'<table class="sortable".*?</table>', page, re.DOTALL)
    assert table.count('<tr class="best">') == 1 and table.count("<tr") == 1 + 15
    assert "aria-sort" in table and page.count('document.createElement("button")') == 1
    assert "<script src" not in page


def test_the_map_has_the_best_mean_over_all_other_settings():
    results = grid()
    points = list(results.points)
    expected = -((np.array(DEPTHS)[:, None] - 3.0) ** 2) - np.log10(KAPPAS) ** 2
    axes = ("planner.kappa", KAPPAS), ("planner.depth", DEPTHS)
    np.testing.assert_allclose(best_means(results, RETURN, points, *axes), expected, atol=1e-12)
    over = best_means(results, RETURN, points, ("planner.kappa", KAPPAS), ("planner.kappa", KAPPAS))
    np.testing.assert_allclose(np.diag(over), expected.max(axis=0), atol=1e-12)
    assert np.isnan(over[0, 1])
    least = best_means(results, Measure("return", is_least=True), points, *axes[:1] * 2)
    np.testing.assert_allclose(np.diag(least), expected.min(axis=0), atol=1e-12)


def reported(results, **report):
    """Results whose sweep has these settings of the report."""
    results.manifest.__dict__["report"] = Report(**report)
    return results


def test_the_map_is_of_the_first_two_numbers_or_of_those_that_the_report_names():
    drawing = heat_map(reported(grid()))
    assert "the best value is at depth 3 and kappa 1." in drawing.alt
    drawing = heat_map(reported(grid(), heat_map=("planner.kappa", "planner.depth")))
    assert "kappa 1 and depth 3" in drawing.alt and "Frame: the best" in drawing.caption
    with pytest.raises(FigureUnavailable, match='kapa is no swept number.*did you mean "planner.kappa"'):
        heat_map(reported(grid(), heat_map=("planner.kapa", "planner.depth")))
    results = reported(in_memory({"a": {"return": np.ones(3)}}))
    with pytest.raises(FigureUnavailable, match="needs two swept numbers"):
        heat_map(results)


def test_long_axes_have_few_ticks():
    swept = {str(n): {"planner.a": n % 40, "planner.b": n // 40} for n in range(80)}
    results = swept_results({name: {"return": np.array([float(name)])} for name in swept}, swept)
    panel = heat_map(reported(results)).figure.axes[0]
    assert [tick.get_text() for tick in panel.get_xticklabels()] == [str(5 * n) for n in range(8)]
    assert len(panel.texts) == 0


def test_the_effect_of_settings_is_of_the_ranked_measure():
    drawing = settings(reported(grid(), rank_by="-rmse"))
    assert drawing.caption.startswith("Mean rmse for each value")
    assert "selected by these same runs: 3, 1.0," in drawing.caption


def test_numbers_ascend_along_an_axis_and_names_keep_their_order():
    swept = {
        str(n): {"planner.a": a, "planner.b": b} for n, (a, b) in enumerate([(3, "y"), (1, "x"), (2, "y")])
    }
    results = swept_results({name: {"return": np.array([float(name)])} for name in swept}, swept)
    number, name = settings(reported(results)).figure.axes
    assert [tick.get_text() for tick in number.get_xticklabels()] == ["1", "2", "3"]
    np.testing.assert_array_equal(number.lines[0].get_ydata(), [np.nan, np.nan, 0.0])
    assert [tick.get_text() for tick in name.get_xticklabels()] == ["y", "x"]
