"""Shortest ways to one point, from a table, beside those of the visibility graph from every position."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from bojax.areas.shortest_ways import shortest_ways
from bojax.areas.transfers import Transfers
from bojax.problems.ways_to_end import WaysToEnd


def comb(num_walls):
    """A square with walls that a way has to wind around, and an odd border."""
    shape = shapely.box(0.0, 0.0, 10.0, 10.0)
    for index in range(num_walls):
        low, high = (0.0, 9.0) if index % 2 else (1.0, 10.0)
        x = 10.0 * (index + 1) / (num_walls + 1)
        shape = shape.difference(shapely.box(x, low, x + 0.3, high))
    return shape.difference(shapely.Point(9.7, 9.7).buffer(0.5))


def channel():
    """A winding channel with a ragged border, too narrow for an outline that is simplified."""
    rng = np.random.default_rng(1)
    headings = np.cumsum(rng.normal(0.0, 0.6, 60))
    middle = np.cumsum(30.0 * np.stack([np.cos(headings), np.sin(headings)], axis=1), axis=0)
    smooth = shapely.segmentize(shapely.LineString(middle).buffer(12.0), 6.0)
    ragged = [
        shapely.LinearRing(np.asarray(ring.coords)[:-1] + rng.normal(0.0, 3.0, (len(ring.coords) - 1, 2)))
        for ring in (smooth.exterior, *smooth.interiors)
    ]
    return max(shapely.get_parts(shapely.Polygon(ragged[0], ragged[1:]).buffer(0)), key=shapely.area)


def table(shape, end):
    found = shortest_ways(shape, end)
    return WaysToEnd(**jax.tree.map(jnp.asarray, found), slack=jnp.asarray(0.0))


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


def test_ways_around_many_corners_stay_in_the_shape(monkeypatch):
    shape = channel()
    transfers, end = Transfers(shape), np.asarray(shape.representative_point().coords[0])
    assert not transfers.has_few_corners
    found = SimpleNamespace(**shortest_ways(shape, end))
    rows, columns = np.nonzero(np.ones(found.first.shape, bool))
    points = found.origin + found.spacing * np.stack([columns, rows], axis=1)
    first = found.first[rows, columns][is_inside := shapely.intersects_xy(shape, *points.T)]
    points = points[is_inside]
    assert len(points) > 500
    assert transfers.are_clear(points, found.corners[first]).all()
    following = found.chains[:, min(1, found.chains.shape[1] - 1)]
    assert transfers.are_clear(found.corners, found.corners[following]).all()
    assert (found.chains[first, -1] == len(found.corners) - 1).all()
    legs = np.linalg.norm(found.corners - found.corners[following], axis=1)
    np.testing.assert_allclose(found.rest, legs + found.rest[following])
    # Beside the visibility graph, whatever the number of its corners.
    monkeypatch.setattr("bojax.areas.transfers.MOST_CORNERS", 10**6)
    lengths = np.linalg.norm(points - found.corners[first], axis=1) + found.rest[first]
    some = np.random.default_rng(0).choice(len(points), 8, replace=False)
    ways = [transfers.path(point, end) for point in points[some]]
    shortest = np.array([np.sum(np.linalg.norm(np.diff(way, axis=0), axis=1)) for way in ways])
    longer = lengths[some] / shortest
    assert longer.min() >= 1.0 - 1e-9 and longer.max() <= 1.15 and longer.mean() <= 1.05
