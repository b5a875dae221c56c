"""Areas, and the distance to their border."""

from typing import Any

import jax
import numpy as np
import pytest
import shapely

from bojax.areas import distance_grid
from bojax.areas.area import Area
from bojax.areas.distance_grid import DistanceGrid
from bojax.areas.shapes import to_shape

HOLE = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
L_SHAPE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 3.0], [3.0, 3.0], [3.0, 8.0], [0.0, 8.0]])
SQUARE = Area.rectangle(0.0, 0.0, 10.0, 10.0)
RING = Area((*SQUARE.outline, HOLE))


def test_a_hole_is_outside_like_a_zone() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 11.0, (500, 2))
    in_hole = ((points > 4.0) & (points < 6.0)).all(1)
    expected = ((points > 0.0) & (points < 10.0)).all(1) & ~in_hole
    np.testing.assert_array_equal(RING.contains(points), expected)
    np.testing.assert_array_equal(SQUARE.without([[HOLE]]).contains(points), expected)


@pytest.mark.parametrize("num_rings", range(1, 8))
def test_its_shape_has_what_lies_in_an_odd_number_of_rings(num_rings: int) -> None:
    rings = [5.0 + (HOLE - 5.0) * 4.0 * 0.8**k for k in range(num_rings)]  # one in the other
    sizes = [64.0 * 0.8 ** (2 * k) for k in range(num_rings)]
    expected = sum(size * (-1) ** k for k, size in enumerate(sizes))
    assert to_shape(Area(tuple(rings))).area == pytest.approx(expected)


def test_overlapping_zones_are_one_zone() -> None:
    area = SQUARE.without([[HOLE], [HOLE + 1.0]])
    assert not area.contains(np.array([[5.5, 5.5], [4.5, 4.5], [6.5, 6.5]])).any()
    assert area.distances(np.array([[5.5, 5.5]]))[0] < 0.0


@pytest.mark.parametrize("area", [RING, SQUARE.without([[HOLE]]), Area((L_SHAPE,))])
def test_distances_agree_with_shapely(area: Area) -> None:
    polygon = shapely.Polygon(
        area.outline[0], [*area.outline[1:], *(ring for zone in area.avoid for ring in zone)]
    )
    points = np.random.default_rng(1).uniform(-2.0, 12.0, (300, 2))
    shapes = shapely.points(points)
    unsigned = shapely.distance(polygon.boundary, shapes)
    expected = np.where(shapely.contains(polygon, shapes), unsigned, -unsigned)
    np.testing.assert_allclose(area.distances(points), expected, atol=1e-12)


def test_a_distance_grid_interpolates_and_its_gradient_points_inside() -> None:
    grid = DistanceGrid.of(RING, 0.1)
    points = np.random.default_rng(2).uniform(0.0, 10.0, (400, 2))
    far = [30.0, 5.0]
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(grid)))(np.concatenate([points, [far]]))
    np.testing.assert_allclose(found[:-1], RING.distances(points), atol=0.08)
    np.testing.assert_allclose(found[-1], -20.0, atol=0.01)
    np.testing.assert_allclose(slopes[-1], [-1.0, 0.0], atol=1e-3)
    assert np.isfinite(slopes).all()


def test_a_grid_has_the_size_of_the_area() -> None:
    points = RING.grid(0.1)
    assert RING.contains(points).all()
    assert len(points) * 0.01 == pytest.approx(96.0, rel=0.01)


def given(wrong: Any) -> Any:
    """Something of another type than is asked for."""
    return wrong


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Area(()), "has no outline"),
        (lambda: Area(given(None)), "has no outline"),
        (lambda: Area((np.eye(2),)), "2 corners"),
        (lambda: Area((given(["here", "there", "nowhere"]),)), "area: a ring is not an array of numbers"),
        (lambda: Area(given(np.eye(3))), r"area: got a ring of shape \(3,\); allowed: rows of x and y"),
        (lambda: Area((np.array([[0.0, 0.0], [1.0, np.nan], [1.0, 1.0]]),)), "not finite"),
        (lambda: Area.rectangle(0.0, 0.0, 0.0, 1.0), "allowed: > 0"),
        (lambda: SQUARE.grid(0.0), "spacing"),
        (lambda: SQUARE.grid(1e-5), "more than"),
        (lambda: Area((np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, 1e-3]]),)).grid(10.0), "no cell"),
    ],
)
def test_bad_areas_are_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_the_distances_of_many_edges_are_searched(monkeypatch) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    star = 5.0 + np.stack([np.cos(turn), np.sin(turn)], axis=1) * (3.0 + np.sin(9.0 * turn))[:, None]
    area = Area((star, 5.0 + 0.2 * (star - 5.0))).without([[HOLE + 2.0]])
    exact = DistanceGrid.of(area, 0.1)
    monkeypatch.setattr(distance_grid, "MOST_PAIRS", 0)
    searched = DistanceGrid.of(area, 0.1)
    np.testing.assert_array_equal(np.sign(searched.values), np.sign(exact.values))
    np.testing.assert_allclose(searched.values, exact.values, atol=0.1 / 16)
    np.testing.assert_array_equal(searched.origin, exact.origin)
