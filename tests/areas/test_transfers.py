"""Paths in areas with many corners: there is one wherever the area is connected, and it stays inside."""

import numpy as np
import pytest
import shapely

from bojax.areas import transfers
from bojax.areas.area import Area
from bojax.areas.shapes import polygons_of, to_area
from bojax.areas.transfers import MOST_CORNERS, Transfers, _outer_corners
from bojax.surveys.lawnmower import lawnmower
from bojax.surveys.mission import Mission
from bojax.surveys.polylines import length_of


def speckled():
    """A square of 60 by 60 cells, of which one in ten is a hole, so that some holes touch."""
    x, y = np.argwhere(np.random.default_rng(0).random((60, 60)) < 0.1).T
    return polygons_of(
        shapely.box(0, 0, 60, 60).difference(shapely.union_all(shapely.box(x, y, x + 1, y + 1)))
    )[0]


def fjords():
    """A sea with two fjords that wind between rough coasts, each narrower than an outline is drawn in."""
    y = np.linspace(0.0, 100.0, 501)
    shift = 3.0 * np.sin(y / 4.0) + np.where(np.arange(501) % 2, 0.02, -0.02)
    bays = [
        shapely.Polygon(
            np.concatenate([np.stack([x + shift, y], 1), np.stack([x + 0.1 + shift, y], 1)[::-1]])
        )
        for x in (10.0, 40.0)
    ]
    return shapely.union_all([*bays, shapely.box(-50.0, 100.0, 100.0, 110.0)])


SHAPES = {"speckled": speckled, "fjords": fjords}


@pytest.fixture(params=SHAPES)
def shape(request):
    made = SHAPES[request.param]()
    assert made.geom_type == "Polygon" and len(_outer_corners(made)) > MOST_CORNERS
    return made


def points_in(shape, number: int) -> np.ndarray:
    """Random points, of which half are beside corners."""
    random = np.random.default_rng(1)
    x_min, y_min, x_max, y_max = shape.bounds
    corners = random.permutation(shapely.get_coordinates(shape))[:2000]
    anywhere = random.uniform([x_min, y_min], [x_max, y_max], (2000, 2))
    both = [corners + random.normal(0.0, 0.05, corners.shape), anywhere]
    return np.concatenate([each[shapely.contains_xy(shape, each)][: number // 2] for each in both])


def is_within(shape, route: np.ndarray) -> bool:
    return bool(shape.buffer(1e-6).covers(shapely.LineString(route)))


def test_a_path_joins_all_points_of_an_area_with_many_corners(shape):
    ways, points = Transfers(shape), points_in(shape, 80)
    for first, last in zip(points, points[::-1], strict=True):
        path = ways.path(first, last)
        np.testing.assert_array_equal(path[[0, -1]], [first, last])
        assert is_within(shape, path)


def test_a_path_among_many_corners_is_nearly_the_shortest(monkeypatch):
    x, y = np.argwhere(np.random.default_rng(0).random((30, 30)) < 0.1).T
    holes = shapely.union_all(shapely.box(x, y, x + 1, y + 1))
    shape = polygons_of(shapely.box(0, 0, 30, 30).difference(holes))[0]
    shortest, points = Transfers(shape), points_in(shape, 40)
    pairs = list(zip(points, np.roll(points, 1, axis=0), strict=True))
    least = np.array([length_of(shortest.path(*pair)) for pair in pairs])
    monkeypatch.setattr(transfers, "MOST_CORNERS", 0)
    found = np.array([length_of(Transfers(shape).path(*pair)) for pair in pairs])
    assert np.all(found >= least * (1.0 - 1e-9))
    assert np.median(found / least) < 1.02
    assert found.sum() < 1.05 * least.sum()


def test_a_path_begins_and_ends_at_corners(shape):
    corners = _outer_corners(shape)
    path = Transfers(shape).path(corners[0], corners[-1])
    np.testing.assert_array_equal(path[[0, -1]], corners[[0, -1]])
    assert is_within(shape, path) and np.all(np.any(np.diff(path, axis=0) != 0.0, axis=1))


def test_without_a_path_among_many_corners_the_error_is_one_line():
    parts = shapely.union_all([fjords(), shapely.box(20.0, 0.0, 30.0, 50.0)])
    for shape in (parts, polygons_of(parts)[0]):
        with pytest.raises(ValueError, match=r"^no path in the area joins \(25, 25\) and \(0, 105\)$"):
            Transfers(shape).path(np.array([25.0, 25.0]), np.array([0.0, 105.0]))


def test_a_lawnmower_over_a_speckled_area_stays_inside():
    shape = speckled()
    assert is_within(shape, lawnmower(to_area(shape), 4.0, 0.3).route)


def test_the_way_of_a_mission_never_leaves_the_area():
    shape, start, end = fjords(), np.array([10.05, 0.0]), np.array([40.05, 0.0])
    area, straight = to_area(shape), float(np.linalg.norm(end - start))
    with pytest.raises(ValueError, match="but the shortest way from the start to the end is 2"):
        Mission(area, straight, start, end, spacing=1.0)
    least = length_of(Transfers(shape).path(start, end))
    survey = Mission(area, least, start, end, spacing=1.0)
    way = np.concatenate([[start], survey.plan()])
    np.testing.assert_array_equal(way[-1], end)
    assert is_within(shape, way)


def test_a_mission_around_an_obstacle_between_samples_does_not_cross_it():
    thin = Area(
        (Area.rectangle(0.0, 0.0, 10.0, 10.0).outline[0], Area.rectangle(5.0, 1.0, 5.001, 9.0).outline[0])
    )
    start, end = np.array([1.0, 5.0]), np.array([9.003, 5.0])
    with pytest.raises(ValueError, match="but the shortest way from the start to the end is 11"):
        Mission(thin, 8.1, start, end, spacing=1.0)


def test_a_mission_between_parts_of_an_area_is_refused():
    parts = Area((*Area.rectangle(0.0, 0.0, 4.0, 4.0).outline, *Area.rectangle(6.0, 0.0, 9.0, 4.0).outline))
    with pytest.raises(ValueError, match=r"no path in the area joins \(1, 1\) and \(8, 1\)"):
        Mission(parts, 30.0, [1.0, 1.0], [8.0, 1.0], spacing=1.0)
