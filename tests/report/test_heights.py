"""What a report shows of a map of heights: its surface with the way on it, and where it is wrong."""

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from matplotlib.patches import Rectangle

from bojax.report import style
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.maps import beliefs
from bojax.report.figures import draw
from bojax.report.source import load
from tests.report.synthetic import edit_manifest, write_monitoring

BOXES = [[0.5, 4.0, 1.5, 5.0], [4.0, 1.0, 5.0, 2.0]]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = write_monitoring(
        tmp_path_factory.mktemp("heights") / "results",
        kind="indoor-props",
        sensor={"kind": "range"},
        field={"kind": "blocks", "boxes": BOXES, "heights": [1.0, 1.0]},
    )
    return load(folder)


def drawing(results, name):
    with style.settings():
        drawn = draw(name, results)
        style.encode(drawn.figure)
        return drawn


def test_every_map_stands_beside_the_truth_on_one_scale(results):
    figure = drawing(results, "surfaces").figure
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["true surface", *(point.name for point in results.points)]
    assert len({axes.get_zlim() for axes in figure.axes}) == 1


def test_the_way_lies_on_the_surface(results):
    figure = drawing(results, "surfaces").figure
    assert len(figure.axes[0].lines) == 0
    for axes, point in zip(figure.axes[1:], results.points, strict=True):
        (line,) = axes.lines
        assert line.get_color() == "black"
        x, y, z = line.get_data_3d()
        belief = beliefs(results, point)[0]
        paths = dict(results.arrays(point, "paths"))[0]["paths"]
        # The way goes through the last pose of every step, as high as the grid around it.
        for end in paths[:, -1]:
            at = np.argmin(np.hypot(x - end[0], y - end[1]))
            assert np.hypot(x[at] - end[0], y[at] - end[1]) < 1e-9
            near = np.ix_(abs(belief["y"] - end[1]) <= 0.2, abs(belief["x"] - end[0]) <= 0.2)
            around = belief["mean"][near]
            assert around.min() - 1e-9 <= z[at] <= around.max() + 1e-9


def test_the_error_is_centred_and_props_are_outlined(results):
    drawn = drawing(results, "error-map")
    panels = [axes for axes in drawn.figure.axes if axes.images][: len(results.points)]
    scales = {image.norm.vmax for axes in panels for image in axes.images}
    assert len(scales) == 1
    for axes, point in zip(panels, results.points, strict=True):
        belief = beliefs(results, point)[0]
        error = belief["mean"] - belief["truth"]
        shown = np.asarray(axes.images[0].get_array())
        np.testing.assert_allclose(shown, error - error.mean(), atol=1e-12)
        outlines = [patch.get_bbox().extents.tolist() for patch in axes.patches if type(patch) is Rectangle]
        assert all(any(np.allclose(box, outline) for outline in outlines) for box in BOXES)
        assert f"{100 * error.std():.3g}" in drawn.caption


def test_what_is_no_height_is_not_drawn_as_a_surface(tmp_path):
    other = load(write_monitoring(tmp_path / "point", sensor={"kind": "point"}))
    for name in ("surfaces", "error-map"):
        with pytest.raises(FigureUnavailable, match="no recorded map of heights"):
            drawing(other, name)


def test_a_map_without_a_way_is_drawn_too(tmp_path):
    folder = write_monitoring(tmp_path / "one", sensor={"kind": "range"}, kind="hilly-terrain", field={})
    edit_manifest(folder, lambda manifest: manifest["points"].__delitem__(slice(1, None)))
    for name in ("runs", "steps"):
        table = pq.read_table(folder / f"{name}.parquet")
        pq.write_table(table.filter(pc.equal(table["point"], 0)), folder / f"{name}.parquet")
    (folder / "arrays" / "0-0-paths-end.npz").unlink()
    figure = drawing(load(folder), "surfaces").figure
    assert [len(axes.lines) for axes in figure.axes] == [0, 0]
