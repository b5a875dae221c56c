"""Mapping heights: field monitoring whose map is looked at as a surface (thesis, Figs. 3.5, 3.7 and 3.8)."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Scalar

from bojax.fields.blocks import Blocks
from bojax.problems.monitoring import FieldBelief, FieldMonitoring, FieldWorld
from bojax.problems.walls import is_free
from bojax.results.schema import Column, Table

CORNER = 0.2
"""Side of a corner, as a share of the domain's."""

SPARSE = 0.25
"""Share of the area, farthest from all samples, in which data count as sparse."""

EDGE = 0.1
"""Distance up to which a place counts as at an edge, in metres."""

AROUND = 0.2
"""Distance from a block within which its reconstruction is looked for, in metres."""


class Map(eqx.Module):
    """The final map, on the grid.

    Attributes:
        points: Positions, in metres.
        mean: Posterior mean, in metres.
        std: Posterior standard deviation, in metres.
        error: Mean less truth, centred: without `offset`.
        offset: Mean error, in metres.
        is_open: Whether the point counts.
    """

    points: Float[Array, "G 2"]
    mean: Float[Array, "G"]
    std: Float[Array, "G"]
    error: Float[Array, "G"]
    offset: Float[Array, ""]
    is_open: Bool[Array, "G"]


class HeightMapping(FieldMonitoring):
    """Learn heights, in metres, from above.

    Beside the scores of field monitoring there are those that a map of heights is judged by. The error is
    centred, as in Fig. 3.8: an offset of the whole map is told apart. A corner is a square with a fifth of
    the domain's side.
    """

    scores: ClassVar[Table] = (
        *FieldMonitoring.scores,
        Column("offset", "float64", "m", "mean error of the final map; positive where it is too high"),
        Column("spread", "float64", "m", "standard deviation of its error over the area"),
        Column("explained_variance", "float64", "", "share of the variance of the heights that it explains"),
        Column(
            "corner_error", "float64", "m", "centred root mean square error in the corners less elsewhere"
        ),
        Column("corner_std", "float64", "m", "mean standard deviation in the corners less elsewhere"),
        Column("sparse_error", "float64", "m", "the error on the quarter of the area farthest from samples"),
    )

    def __check_init__(self):
        """A robot that flies has to fly above the ground.

        Raises:
            ValueError: It does not everywhere in the domain.
        """
        altitude = self.vehicle.flight_altitude
        highest = float(jnp.max(self.field.values(self.grid())))
        if altitude is not None and altitude <= highest:
            raise ValueError(
                f"vehicle.altitude: got {altitude:g}; the ground rises to {highest:.2f} m: fly higher"
            )

    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """See the class."""
        found = self.map(belief)
        truth = found.mean - found.error - found.offset
        spread = _rms(found.error, found.is_open)
        relief = _rms(truth - _mean(truth, found.is_open), found.is_open)
        corner = found.is_open & self._is_corner(found.points)
        rest = found.is_open & ~corner
        distance = self._distance(found.points, belief)
        sparse = found.is_open & (distance >= jnp.quantile(distance, 1.0 - SPARSE))
        return super().score(world, belief) | {
            "offset": found.offset,
            "spread": spread,
            "explained_variance": 1.0 - (spread / relief) ** 2,
            "corner_error": _rms(found.error, corner) - _rms(found.error, rest),
            "corner_std": _mean(found.std, corner) - _mean(found.std, rest),
            "sparse_error": _rms(found.error, sparse),
        }

    def map(self, belief: FieldBelief) -> Map:
        """What is believed at the end."""
        points = self.grid()
        mean, variance = self._predict(belief, points)
        is_open = is_free(points, self.domain, self.walls)
        error = mean - self.field.values(points)
        offset = _mean(error, is_open)
        return Map(points, mean, jnp.sqrt(variance), error - offset, offset, is_open)

    def _is_corner(self, points: Float[Array, "G 2"]) -> Bool[Array, "G"]:
        low, high = self.domain[None, :2], self.domain[None, 2:]
        part = (points - low) / (high - low)
        return jnp.all((part <= CORNER) | (part >= 1.0 - CORNER), axis=-1)

    def _distance(self, points: Float[Array, "G 2"], belief: FieldBelief) -> Float[Array, "G"]:
        """To the nearest sample, in metres; a row of the grid at a time."""
        posterior = belief.posterior

        def nearest(row: Float[Array, "R 2"]) -> Float[Array, "R"]:
            squared = jnp.sum((row[:, None] - posterior.x[None]) ** 2, axis=-1)
            return jnp.sqrt(jnp.min(jnp.where(posterior.is_held()[None], squared, jnp.inf), axis=1))

        return jax.lax.map(nearest, points.reshape(self.resolution, self.resolution, 2)).ravel()


class PropMapping(HeightMapping):
    """Learn the heights of a floor with sharp-edged props (thesis, Section 3.5.2).

    A place is at an edge within 0.1 m of the border of a prop. A prop is found where the map within 0.2 m of
    it is above half its height in the right place: the area that it shares with the prop is more than half
    of what one of them covers. What other props cover does not count.
    """

    scores: ClassVar[Table] = (
        *HeightMapping.scores,
        Column("edge_error", "float64", "m", "centred root mean square error at the edges of props"),
        Column("edge_excess", "float64", "m", "the same less that elsewhere"),
        Column("props_found", "float64", "", "share of the props that the final map shows, in their place"),
    )

    def __check_init__(self):
        """Props are blocks.

        Raises:
            ValueError: The field is something else.
        """
        if not isinstance(self.field, Blocks):
            raise ValueError("field: props are blocks; a map of another field is hilly-terrain's")

    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """See the class."""
        found = self.map(belief)
        outside = self._outside(found.points)
        edge = found.is_open & jnp.any(jnp.abs(outside) <= EDGE, axis=1)
        at_edges = _rms(found.error, edge)
        return super().score(world, belief) | {
            "edge_error": at_edges,
            "edge_excess": at_edges - _rms(found.error, found.is_open & ~edge),
            "props_found": jnp.mean(self._is_found(found, outside).astype(at_edges.dtype)),
        }

    def _outside(self, points: Float[Array, "G 2"]) -> Float[Array, "G K"]:
        """Distance of each point from each block, in metres; negative inside."""
        low, high = self._blocks.boxes[None, :, :2], self._blocks.boxes[None, :, 2:]
        beyond = jnp.maximum(low - points[:, None], points[:, None] - high)
        away = jnp.sqrt(jnp.sum(jnp.maximum(beyond, 0.0) ** 2, axis=-1))
        return away + jnp.minimum(jnp.max(beyond, axis=-1), 0.0)

    def _is_found(self, found: Map, outside: Float[Array, "G K"]) -> Bool[Array, "K"]:
        on = outside <= 0.0
        is_other = jnp.any(on, axis=1, keepdims=True) & ~on
        near = found.is_open[:, None] & (outside <= AROUND) & ~is_other
        high = near & (found.mean[:, None] > 0.5 * self._blocks.heights[None])
        on = near & on
        return 2 * jnp.sum(high & on, axis=0) > jnp.sum(high | on, axis=0)

    @property
    def _blocks(self) -> Blocks:
        assert isinstance(self.field, Blocks)
        return self.field


def _mean(values: Float[Array, "G"], where: Bool[Array, "G"]) -> Scalar:
    return jnp.sum(jnp.where(where, values, 0.0)) / jnp.maximum(jnp.sum(where), 1).astype(values.dtype)


def _rms(values: Float[Array, "G"], where: Bool[Array, "G"]) -> Scalar:
    return jnp.sqrt(_mean(values * values, where))
