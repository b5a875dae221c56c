"""What a report shows of a sweep that learns a field: maps, paths into walls, errors beside the thesis's."""

from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from bojax.config.component import registry
from bojax.config.sweep_file import Report
from bojax.report import style
from bojax.report.build import build_report
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.domains import draw_outline, tick_outline
from bojax.report.drawing.maps import beliefs, draw_map
from bojax.report.figures import draw
from bojax.report.figures.maps import _maps, _norms
from bojax.report.figures.paths import stops
from bojax.report.source import Results, load
from bojax.report.tables import outcomes, ratios, thesis_gaps
from bojax.results.outline import Outline
from tests.report.synthetic import SPACE, edit_manifest, manifest_of, point_of, write_monitoring

THESIS = {
    "sbo-5": {"rmse": 72.9, "wrmse": 61.9, "mnll": 0.3, "runtime_s": 106},
    "kcbts": {"rmse": 42.6, "wrmse": 36.9, "mnll": -1.16},
}
REPORT = {"thesis": THESIS, "relative_to": "kcbts"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_monitoring(tmp_path_factory.mktemp("monitoring") / "results", report=REPORT)
    build_report(folder)
    return folder


@pytest.fixture(scope="module")
def page(folder):
    return unescape((folder / "report.html").read_text())


def drawing(results, name):
    with style.settings():
        return draw(name, results)


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_all_that_makes_sense_is_drawn(folder):
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert names == {"accumulated-reward", "returns", "errors", "paths", "beliefs"}


class TestPaths:
    def test_what_stops_a_run_is_marked_and_no_failure_is_spoken_of(self, folder):
        drawn = drawing(load(folder), "paths")
        assert "kcbts: run 0, stopped 0 times, goal reached" in drawn.alt
        assert "sbo-5: run 0, stopped 1 time, goal not reached" in drawn.alt
        assert legend(drawn.figure) == ["path", "start", "stopped", "obstacle", "goal"]
        assert "fail" not in drawn.caption + drawn.alt and "succe" not in drawn.caption + drawn.alt

    def test_without_walls_and_target_they_are_not_in_the_legend(self, tmp_path):
        folder = write_monitoring(tmp_path / "open", walls=None, target_area=None, start=None)
        drawn = drawing(load(folder), "paths")
        assert legend(drawn.figure) == ["path", "start", "stopped"]
        assert "goal" not in drawn.alt

    def test_the_field_is_drawn_where_it_was_recorded(self, folder, tmp_path):
        assert all(len(axes.images) == 1 for axes in drawing(load(folder), "paths").figure.axes[:3])
        bare = write_monitoring(tmp_path / "bare")
        for path in (bare / "arrays").glob("*belief*"):
            path.unlink()
        drawn = drawing(load(bare), "paths")
        assert not any(axes.images for axes in drawn.figure.axes)
        assert "true field" not in drawn.caption
        with pytest.raises(FigureUnavailable, match="no recorded belief"):
            drawing(load(bare), "beliefs")

    def test_a_robot_is_stopped_where_its_poses_repeat(self):
        straight = np.stack([np.arange(1.0, 5.0), np.zeros(4), np.zeros(4)], axis=1)
        start, blocked, first = np.zeros(3), straight.copy(), np.zeros((4, 3))
        blocked[2:] = blocked[1]
        assert stops([start], [straight]).shape == (0, 2)
        np.testing.assert_array_equal(stops([start], [blocked]), [[2.0, 0.0]])
        # Stopped before the first sample, and by the last one alone.
        np.testing.assert_array_equal(stops([start, start], [first, first[:1]]), np.zeros((2, 2)))


class TestMaps:
    @pytest.mark.parametrize("kind", ["space-modelling", "two-pits", "diagonal", "monitoring"])
    def test_the_domain_is_that_of_the_problem(self, kind):
        with style.settings():
            _, grid = style.figure(3.0)
            settings = {**SPACE, "kind": kind, "domain": [-1.0, 0.0, 9.0, 4.0]}
            outline = registry["problem"][kind].model_validate(settings).outline
            draw_outline(grid[0, 0], outline)
            tick_outline(grid[0, 0], outline)
        boxes = [
            list(patch.get_bbox().extents) for patch in grid[0, 0].patches if isinstance(patch, Rectangle)
        ]
        assert [-1.0, 0.0, 9.0, 4.0] in boxes
        assert all(any(np.allclose(box, wall) for box in boxes) for wall in SPACE["walls"])
        assert [tick.get_text() for tick in grid[0, 0].get_xticklabels()] == ["\N{MINUS SIGN}1", "4", "9"]

    @pytest.mark.parametrize("turn", [1, -1])
    def test_what_is_not_in_the_area_is_drawn_as_an_obstacle(self, turn):
        def square(low, high):
            return [(low, low), (high, low), (high, high), (low, high)][::turn]

        # A lake with an island that has a pond.
        outline = Outline(border=(0.0, 0.0, 10.0, 10.0), area=[square(1, 9), square(3, 7), square(4, 6)])
        with style.settings():
            figure, grid = style.figure(4.0)
            draw_outline(grid[0, 0], outline)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[::-1]
        for at, is_obstacle in ((0.5, True), (2.0, False), (3.5, True), (5.0, False), (9.5, True)):
            x, y = np.round(grid[0, 0].transData.transform((at, at))).astype(int)
            assert (pixels[y, x, 0] < 128) == is_obstacle, at

    def test_the_first_axis_is_y_and_points_of_the_grid_are_centres_of_cells(self):
        belief = {"x": np.array([0.0, 1.0, 2.0]), "y": np.array([0.0, 4.0])}
        values = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        with style.settings():
            _, grid = style.figure(3.0)
            image = draw_map(grid[0, 0], belief, values, Normalize(0, 1), "viridis")
        assert image.get_extent() == [-0.5, 2.5, -2.0, 6.0]
        assert image.origin == "lower"  # the high value is at the bottom right: x 2, y 0

    def test_settings_share_their_scales(self, folder):
        results = load(folder)
        maps = [_maps(beliefs(results, point)[0]) for point in results.points]
        norms = _norms(maps)
        assert norms["true field"] is norms["mean"]
        bounds = {name: (float(norm.vmin or 0), float(norm.vmax or 0)) for name, norm in norms.items()}
        assert bounds["error"][0] == -bounds["error"][1] and bounds["std"][0] == 0
        for name, (low, high) in bounds.items():
            assert all(low <= values[name].min() and values[name].max() <= high for values in maps)

    def test_the_error_is_that_of_the_mean(self, folder):
        drawn = drawing(load(folder), "beliefs")
        belief = beliefs(load(folder), load(folder).points[0])[0]
        error = drawn.figure.axes[2].images[0].get_array()
        np.testing.assert_array_equal(error, belief["mean"] - belief["truth"])
        samples = drawn.figure.axes[3].collections[-1].get_offsets()
        np.testing.assert_array_equal(samples, belief["samples"][:, :2])


class TestErrors:
    def test_the_thesis_is_compared_by_ratios(self, folder):
        table = ratios(load(folder))
        assert table is not None
        assert table.headings == ["rmse / kcbts", "wrmse / kcbts"]  # of mnll, one is below 0
        rows = dict(table.rows)
        assert set(rows) == {"kcbts", "sbo-5"}  # the thesis has nothing on sbo-9
        assert rows["sbo-5"][0].thesis == "1.71" and rows["sbo-5"][1].thesis == "1.68"
        assert float(rows["sbo-5"][0].text) == pytest.approx(2.0, abs=0.02)  # 0.2 / 0.1
        assert rows["kcbts"][0].text == "1.00" and rows["kcbts"][0].interval == ""

    def test_the_page_has_both(self, page):
        assert "thesis 72.9" in page and "thesis 1.71" in page
        assert "report.thesis has runtime_s, which is no column of the results." in page

    def test_a_name_that_no_setting_has_is_noted(self, folder):
        results = load(folder)
        thesis = {"kcbts": {"rmse": 1.0}, "kcbst": {"rmse": 2.0}}
        report = results.report.model_copy(update={"thesis": thesis})
        results = replace(results, manifest=results.manifest.model_copy(update={"report": report}))
        assert thesis_gaps(results) == ["report.thesis has numbers of kcbst, but no setting is called that."]

    def test_the_figure_has_a_panel_per_measure_and_one_per_ratio(self, folder):
        drawn = drawing(load(folder), "errors")
        titles = [axes.get_title() for axes in drawn.figure.axes if axes.get_visible()]
        assert titles == ["RMSE", "WRMSE", "MNLL", "RMSE ratio", "WRMSE ratio"]
        assert legend(drawn.figure) == ["here", "thesis"]
        (thesis,) = [line for line in drawn.figure.axes[3].lines if line.get_marker() == "D"]
        np.testing.assert_allclose(np.asarray(thesis.get_xdata()), [72.9 / 42.6])

    def test_without_a_reference_there_are_no_ratios(self, folder, tmp_path):
        plain = write_monitoring(tmp_path / "plain", report={"thesis": THESIS})
        assert ratios(load(plain)) is None and not drawing(load(plain), "errors").figure.legends
        edit_manifest(plain, lambda manifest: manifest["report"].update(relative_to="nobody"))
        assert "No ratios are shown, because no setting is called nobody." in thesis_gaps(load(plain))
        assert ratios(load(plain)) is None


def test_steps_do_not_tell_when_a_run_succeeded_that_goes_on(folder, tmp_path):
    headings = outcomes(load(folder)).headings
    assert "success" in headings
    assert not [heading for heading in headings if "step" in heading]
    with pytest.raises(FigureUnavailable, match="does not end at success"):
        drawing(load(folder), "success")
    unaimed = load(write_monitoring(tmp_path / "unaimed", target_area=None))
    assert "success" not in outcomes(unaimed).headings


def test_a_number_of_the_thesis_belongs_to_the_variant_of_its_name_where_there_is_one():
    names = [("kcbts", "kcbts"), ("kcbts", "kcbts-wide"), ("sbo", "sbo-5")]
    points = tuple(point_of(i, label, variant) for i, (label, variant) in enumerate(names))
    thesis = {"kcbts": {"rmse": 1.0}, "sbo": {"rmse": 2.0}}
    results = Results(Path(), manifest_of(report=Report(thesis=thesis)), points)
    assert [results.thesis(point, "rmse") for point in points] == [1.0, None, 2.0]
