"""Height mapping: learn a surface from the air (thesis, Figs. 3.5, 3.7 and 3.8)."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Scalar
from typing_extensions import override

from bojax.fields.closed_form import Blocks
from bojax.models.checks import check_takes
from bojax.models.kernels import Kernel
from bojax.problems.field_belief import FieldBelief
from bojax.problems.field_errors import FIELD_COLUMNS
from bojax.problems.field_problem import FieldProblem, FieldWorld
from bojax.results.schema import Column, Table

CORNERS = ("sw", "nw", "se", "ne")
"""Suffixes of the columns of the four corners; north is the upper end of the second axis."""

CORNER = 0.2  # side of a corner region, as a share of the side of the domain
SPARSE = 0.25  # share of the area, farthest from all samples, where data count as sparse
EDGE = 0.1  # largest distance of a point at an edge from the border of a prop, in metres
AROUND = 0.2  # reach around a prop of the comparison with its reconstruction, in metres


def _in_metres(name: str, doc: str) -> Column:
    return Column(name, "float64", "m", doc, nullable=True)


MAP_COLUMNS: Table = (
    Column("offset", "float64", "m", "mean error of the final map; positive where it is too high"),
    Column("spread", "float64", "m", "standard deviation of its error over the area"),
    Column(
        "explained_variance",
        "float64",
        "",
        "share of the variance of the heights that it explains; NaN for a flat field",
    ),
    *(
        _in_metres(
            f"corner_error_{corner}",
            f"centred root mean square error in the {corner} corner less that outside all corners; null if "
            "one of both regions has no grid point",
        )
        for corner in CORNERS
    ),
    *(
        _in_metres(
            f"corner_std_{corner}",
            f"mean standard deviation in the {corner} corner less that outside all corners; null if one of "
            "both regions has no grid point",
        )
        for corner in CORNERS
    ),
    _in_metres(
        "sparse_error",
        "the error on the quarter of the area farthest from samples; null if it has no grid point",
    ),
)

PROP_COLUMNS: Table = (
    _in_metres(
        "edge_error",
        "centred root mean square error at the edges of props; null if no grid point is at an edge",
    ),
    _in_metres("edge_excess", "the same less that elsewhere; null if one of both has no grid point"),
    Column("props_found", "float64", "", "share of the props that the final map shows, in their place"),
    Column(
        "gap_height",
        "float64",
        "",
        "mean height of the final map between the two nearest props, as a share of the lower one; null if no "
        "grid point is there",
        nullable=True,
    ),
)


class Map(eqx.Module):
    """The final map on the grid."""

    points: Float[Array, "G 2"]  # grid points, in metres
    mean: Float[Array, "G"]  # posterior mean, in metres
    std: Float[Array, "G"]  # posterior standard deviation, in metres
    error: Float[Array, "G"]  # error of the mean minus `offset`, in metres
    offset: Float[Array, ""]  # mean error, in metres
    is_open: Bool[Array, "G"]  # whether a point counts; points in walls do not


def final_map(problem: FieldProblem, belief: FieldBelief) -> Map:
    """The map that a belief contains."""
    points = problem.grid()
    mean, variance = belief.predict_grid(points, problem.resolution)
    is_open = problem.arena.is_free(points)
    error = mean - problem.true_field.values(points)
    offset = _mean(error, is_open)
    return Map(points, mean, jnp.sqrt(variance), error - offset, offset, is_open)


class HeightMapping(FieldProblem):
    """Learn heights in metres from the air.

    The scores of field monitoring are complemented by those of a height map, `MAP_COLUMNS`. Errors are
    centred as in Fig. 3.8; the mean error is a score of its own. A corner region is a square with a fifth of
    the side of the domain. The thesis makes its statement of all four corners (p. 76): each has its scores.

    Settings: `bojax.problems.settings.HillyTerrain`.
    """

    scores: ClassVar[Table] = FIELD_COLUMNS + MAP_COLUMNS

    @override
    def __check_init__(self):
        _check_altitude(self)

    @override
    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        return super().score(world, belief) | map_score(self, belief, final_map(self, belief))


class PropMapping(FieldProblem):
    """Learn the heights of a floor with sharp-edged props (thesis, Section 3.5.2).

    The scores of `HeightMapping` are complemented by `PROP_COLUMNS`. With `map_kernel`, the map that is
    scored and recorded is made with this kernel, as in Fig. 3.8, while the flight is planned with `kernel`.

    Settings: `bojax.problems.settings.IndoorProps`.
    """

    scores: ClassVar[Table] = FIELD_COLUMNS + MAP_COLUMNS + PROP_COLUMNS

    map_kernel: Kernel | None = eqx.field(default=None, kw_only=True)

    @override
    def __check_init__(self):
        """Check that the field consists of blocks that a robot flies above, or raise ValueError."""
        if self.map_kernel is not None:
            place = "the coordinates of the plane"
            check_takes("map_kernel", self.map_kernel, 2, 2, self.domain.dtype, place)
        _ = self._blocks
        _check_altitude(self)

    @override
    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        belief = self._mapped(belief)
        final = final_map(self, belief)
        outside = self._outside(final.points)
        edge = final.is_open & jnp.any(jnp.abs(outside) <= EDGE, axis=1)
        at_edges = _rms(final.error, edge)
        return (
            super().score(world, belief)
            | map_score(self, belief, final)
            | {
                "edge_error": at_edges,
                "edge_excess": at_edges - _rms(final.error, final.is_open & ~edge),
                "props_found": jnp.mean(self._is_found(final, outside).astype(at_edges.dtype)),
                "gap_height": self._gap_height(final, outside),
            }
        )

    @override
    def snapshot(self, world: FieldWorld, belief: FieldBelief) -> dict[str, dict[str, Array]]:
        return super().snapshot(world, self._mapped(belief))

    def _mapped(self, belief: FieldBelief) -> FieldBelief:
        """The belief that the samples of the flight give with the kernel of the map."""
        if self.map_kernel is None:
            return belief
        old = belief.posterior
        new = old.refitted(self.map_kernel, old.noise_variance)
        return replace(belief, posterior=new)

    def _outside(self, points: Float[Array, "G 2"]) -> Float[Array, "G K"]:
        """Signed distance of each point from each block, in metres; negative inside."""
        low, high = self._blocks.boxes[None, :, :2], self._blocks.boxes[None, :, 2:]
        beyond = jnp.maximum(low - points[:, None], points[:, None] - high)
        away = jnp.sqrt(jnp.sum(jnp.maximum(beyond, 0.0) ** 2, axis=-1))
        return away + jnp.minimum(jnp.max(beyond, axis=-1), 0.0)

    def _is_found(self, final: Map, outside: Float[Array, "G K"]) -> Bool[Array, "K"]:
        # A prop is found if the region around it where the map exceeds half its height overlaps the prop by
        # more than half of their union; points on other props do not count.
        on = outside <= 0.0
        is_other = jnp.any(on, axis=1, keepdims=True) & ~on
        near = final.is_open[:, None] & (outside <= AROUND) & ~is_other
        high = near & (final.mean[:, None] > 0.5 * self._blocks.heights[None])
        on = near & on
        return 2 * jnp.sum(high & on, axis=0) > jnp.sum(high | on, axis=0)

    def _gap_height(self, final: Map, outside: Float[Array, "G K"]) -> Scalar:
        # Between two props is what their common bounding box has outside all props.
        first, second = np.triu_indices(len(self._blocks.heights), 1)
        if not len(first):
            return jnp.full_like(final.offset, jnp.nan)
        low, high, heights = self._blocks.boxes[:, :2], self._blocks.boxes[:, 2:], self._blocks.heights
        apart = jnp.maximum(jnp.maximum(low[first] - high[second], low[second] - high[first]), 0.0)
        nearest = jnp.argmin(jnp.sum(apart**2, axis=1))
        pair = jnp.asarray(np.stack([first, second], axis=1))[nearest]
        lowest, highest = jnp.min(low[pair], axis=0)[None], jnp.max(high[pair], axis=0)[None]
        is_inside = (final.points >= lowest) & (final.points <= highest)
        between = final.is_open & jnp.all(is_inside, axis=1) & jnp.all(outside > 0.0, axis=1)
        return _mean(final.mean, between) / jnp.min(heights[pair])

    @property
    def _blocks(self) -> Blocks:
        if not isinstance(self.field, Blocks):
            raise ValueError("field: prop mapping needs a field of kind blocks; hilly-terrain maps any field")
        return self.field


def map_score(problem: FieldProblem, belief: FieldBelief, final: Map) -> dict[str, Scalar]:
    """The columns of `MAP_COLUMNS`."""
    truth = problem.true_field.values(final.points)
    spread = _rms(final.error, final.is_open)
    relief = _rms(truth - _mean(truth, final.is_open), final.is_open)
    # Rounding would give a flat field a relief that nothing can be divided by.
    highest = jnp.max(truth, where=final.is_open, initial=-jnp.inf)
    is_flat = highest <= jnp.min(truth, where=final.is_open, initial=jnp.inf)
    corners = final.is_open[None] & _corners(final.points, problem.domain)
    rest = final.is_open & ~jnp.any(corners, axis=0)
    distance = _distance_to_samples(final.points, belief, problem.resolution)
    error = jax.vmap(_rms, (None, 0))(final.error, corners) - _rms(final.error, rest)
    std = jax.vmap(_mean, (None, 0))(final.std, corners) - _mean(final.std, rest)
    sparse = final.is_open & (distance >= jnp.quantile(distance, 1.0 - SPARSE))
    return {
        "offset": final.offset,
        "spread": spread,
        "explained_variance": jnp.where(is_flat, jnp.nan, 1.0 - (spread / relief) ** 2),
        **_by_corner("corner_error", error),
        **_by_corner("corner_std", std),
        "sparse_error": _rms(final.error, sparse),
    }


def _check_altitude(problem: FieldProblem) -> None:
    altitude = problem.vehicle.flight_altitude
    highest = float(jnp.max(problem.true_field.values(problem.grid())))
    if altitude is not None and altitude <= highest:
        raise ValueError(
            f"vehicle.altitude: got {altitude:g}; the ground rises to {highest:.2f} m: set a larger altitude"
        )


def _corners(points: Float[Array, "G 2"], domain: Float[Array, "4"]) -> Bool[Array, "4 G"]:
    """Whether points lie in each of the four corner regions, in the order of `CORNERS`."""
    low, high = domain[None, :2], domain[None, 2:]
    part = (points - low) / (high - low)
    at_low, at_high = part <= CORNER, part >= 1.0 - CORNER
    return jnp.stack([x[:, 0] & y[:, 1] for x in (at_low, at_high) for y in (at_low, at_high)])


def _distance_to_samples(
    points: Float[Array, "G 2"], belief: FieldBelief, resolution: int
) -> Float[Array, "G"]:
    """Distance to the nearest sample, in metres, computed row by row of the grid."""
    posterior = belief.posterior

    def nearest(row: Float[Array, "R 2"]) -> Float[Array, "R"]:
        squared = jnp.sum((row[:, None] - posterior.x[None]) ** 2, axis=-1)
        return jnp.sqrt(jnp.min(jnp.where(posterior.is_held()[None], squared, jnp.inf), axis=1))

    return jax.lax.map(nearest, points.reshape(resolution, resolution, 2)).ravel()


def _by_corner(name: str, values: Float[Array, "4"]) -> dict[str, Scalar]:
    """The columns of the four corners; NaN of a corner without grid points."""
    return {f"{name}_{corner}": value for corner, value in zip(CORNERS, values, strict=True)}


def _mean(values: Float[Array, "G"], where: Bool[Array, "G"]) -> Scalar:
    """Mean over the points that count; NaN if none does."""
    return jnp.sum(jnp.where(where, values, 0.0)) / jnp.sum(where).astype(values.dtype)


def _rms(values: Float[Array, "G"], where: Bool[Array, "G"]) -> Scalar:
    return jnp.sqrt(_mean(values * values, where))
