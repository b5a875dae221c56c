"""Shortest ways to one point, from a table, beside those of the visibility graph from every position."""

import jax.numpy as jnp
import numpy as np
import pytest

shapely = pytest.importorskip("shapely")

from bojax.areas.shortest_ways import shortest_ways  # noqa: E402
from bojax.areas.transfers import Transfers  # noqa: E402
from bojax.problems.ways_to_end import WaysToEnd  # noqa: E402


def comb(num_walls):
    """A square with walls that a way has to wind around, and an odd border."""
    shape = shapely.box(0.0, 0.0, 10.0, 10.0)
    for index in range(num_walls):
        low, high = (0.0, 9.0) if index % 2 else (1.0, 10.0)
        x = 10.0 * (index + 1) / (num_walls + 1)
        shape = shape.difference(shapely.box(x, low, x + 0.3, high))
    return shape.difference(shapely.Point(9.7, 9.7).buffer(0.5))


def table(shape, end):
    found = shortest_ways(shape, end)
    arrays = {name: jnp.asarray(value) for name, value in vars(found).items() if name != "legs"}
    return WaysToEnd(**arrays, slack=jnp.asarray(0.0), legs=found.legs)


@pytest.mark.parametrize(
    "shape",
    [comb(0), comb(3), comb(6), comb(0).difference(shapely.Point(5, 4).buffer(2.0))],
    ids=["square", "comb", "narrow comb", "hole"],
)
def test_ways_are_as_short_as_those_of_the_visibility_graph(shape):
    end, transfers = np.array([0.5, 0.5]), Transfers(shape)
    points = np.random.default_rng(0).uniform(0.0, 10.0, (150, 2))
    points = points[shapely.contains_xy(shape, *points.T)]
    ways = table(shape, end)
    expected = [transfers.path(point, end) for point in points]
    lengths = np.array([np.sum(np.linalg.norm(np.diff(way, axis=0), axis=1)) for way in expected])
    np.testing.assert_allclose(ways.distance(jnp.asarray(points)), lengths, atol=0.1 * 10.0 / 128)
    for point, length in zip(points[:20], lengths, strict=False):
        way = np.asarray(ways.way(jnp.asarray(point)))
        np.testing.assert_array_equal(way[-1], end)
        assert np.sum(np.linalg.norm(np.diff(way, axis=0), axis=1)) == pytest.approx(length, abs=0.01)
        assert shapely.buffer(shape, 0.1).covers(shapely.LineString(way))
