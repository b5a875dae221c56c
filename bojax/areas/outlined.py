"""The area that a robot may drive in: polygons with holes and no-go zones, as obstacles on the device."""

from math import ceil

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bojax.areas.area import Area, longer_side
from bojax.areas.distance_grid import DistanceGrid
from bojax.models.checks import compiled_if_known


class OutlinedArea(eqx.Module):
    """An area from files, as a table of the signed distance to its border.

    Whether a point is inside is one lookup, so that the cost does not depend on the number of corners. The
    table knows the border to half a cell, and sharp corners to one: a point counts as inside if it is at most
    that far outside. Obstacles narrower than two cells may be missed.

    Settings: `bojax.areas.settings.OutlinedArea`.
    """

    distance: DistanceGrid  # signed distance to the border, m; negative outside
    corners: Float[Array, "P 2"]  # corners of all borders, one ring after the other, m
    ring_ends: tuple[int, ...] = eqx.field(static=True)  # number of corners up to the end of each ring
    # Number of points of a straight line between two poses that must be inside, its end included
    checks: int = eqx.field(static=True)

    def __init__(
        self,
        file: str,
        avoid: tuple[str, ...] = (),
        below: float | None = None,
        frame: str | None = None,
        resolution: int = 400,
        checks: int = 8,
        sha256: str | None = None,
    ):
        """Read the area, and compute the table; `sha256` is checked with the settings."""
        from bojax.areas.place import read_outlined  # not at the start of every run

        area = read_outlined(file, tuple(avoid), below, frame, sha256).area
        self.distance = DistanceGrid.of(area, longer_side(area.bounds) / resolution)
        self.corners = jnp.asarray(np.concatenate(area.outline))
        self.ring_ends = tuple(np.cumsum([len(ring) for ring in area.outline]).tolist())
        self.checks = checks

    @property
    def rings(self) -> list[np.ndarray]:
        """The borders of the area and of its holes, `[P, 2]` each, m."""
        return np.split(np.asarray(self.corners, float), self.ring_ends[:-1])

    @property
    def area(self) -> Area:
        """The area on the host."""
        return Area(tuple(self.rings))

    @compiled_if_known
    def is_inside(self, points: Float[Array, "*N 2"]) -> Bool[Array, "*N"]:
        """Whether points are in the area, or at most half a cell outside."""
        return self._depth(points) >= 0.0

    def is_blocked(self, trajectory: Float[Array, "T _"]) -> Bool[Array, "T-1"]:
        """Whether each straight line between two poses leaves the area.

        The first line may start outside, as that of a robot that misreads its position beside the border
        may: then it must end inside, and not lead farther out.
        """
        begin, end = trajectory[:-1, None, :2], trajectory[1:, None, :2]
        shares = jnp.arange(1, self.checks + 1, dtype=trajectory.dtype) / self.checks
        depths = self._depth(begin + shares[None, :, None] * (end - begin))
        is_first = jnp.arange(depths.shape[0]) == 0
        outside = jnp.minimum(self._depth(trajectory[0, :2]), 0.0)
        least = jnp.where(is_first, outside, 0.0)
        return jnp.any(depths < least[:, None], axis=1) | (depths[:, -1] < 0.0)

    def _depth(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        return self.distance(points) + 0.5 * self.distance.spacing


def check_sampling(area: OutlinedArea, step: float) -> None:
    """Refuse too few checks for paths with a pose every `step` metres, or raise ValueError."""
    cell = float(area.distance.spacing)
    least = ceil(step / (2.0 * cell) - 1e-6)
    if area.checks < least:
        raise ValueError(
            f"problem.area.checks: got {area.checks}; allowed: >= {least}, so that paths with a pose every "
            f"{step:.3g} m are checked at every second cell of {cell:.3g} m"
        )
