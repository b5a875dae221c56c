"""Spline trajectories: the discrete sets of 5, 9 and 17 actions (Fig. 4.2a) and a continuous family."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from typing_extensions import override

from bojax.motions.base import ContinuousMotions, DiscreteMotions, Path, sample_by_arc_length

# Coefficients (b_x, c_x, b_y, c_y) of left turns x = b_x u^2 + c_x u, y = b_y u^2 + c_y u; each has a mirror
# image that turns right. The sets of 9 and 17 extend the smaller ones. The coefficients are from copies of
# the author's planning code; the thesis shows the sets only in a figure.
_STRAIGHT = (0.0, 0.72, 0.0, 0.0)
_LEFT_TURNS = {
    5: ((0.0, 0.55, 0.5, -0.1), (-0.33, 0.71, 0.52, 0.0)),
    9: ((0.0, 0.65, 0.34, -0.08), (-0.20, 0.67, 0.475, 0.0)),
    17: (
        (0.0, 0.705, 0.14, -0.02),
        (0.0, 0.61, 0.40, -0.08),
        (-0.15, 0.66, 0.44, 0.0),
        (-0.27, 0.69, 0.5, 0.0),
    ),
}


class SplineSet(DiscreteMotions):
    """The 5, 9 or 17 spline actions of Fig. 4.2a, of equal arc length and starting along the heading.

    Published curves with c_y other than 0 start 1.6 to 10.3 degrees off the heading; they are rotated onto
    it.

    Settings: `bojax.motions.settings.Splines`.
    """

    length: Float[Array, ""]
    actions: Float[Array, ""]
    num_samples: int = eqx.field(static=True)
    # Number of paths, by default all of the set. Larger sets extend the smaller ones
    room: int = eqx.field(static=True)

    def __init__(
        self,
        length: Float[Array, ""],
        actions: int | Float[Array, ""],
        num_samples: int,
        room: int | None = None,
    ):
        self.length, self.actions = length, jnp.asarray(actions, length.dtype)
        self.num_samples, self.room = num_samples, int(actions) if room is None else room

    @property
    @override
    def num_actions(self) -> int:
        return self.room

    @property
    @override
    def count(self) -> Int[Array, ""]:
        return self.actions.astype(jnp.int32)

    @override
    def with_room(self) -> "SplineSet":
        return SplineSet(self.length, self.actions, self.num_samples, max(_LEFT_TURNS))

    @override
    def paths(self) -> Float[Array, "A S 3"]:
        """All paths: the straight line, then each left turn followed by its mirror image."""
        rows = [_STRAIGHT]
        for size, turns in _LEFT_TURNS.items():
            if size <= self.room:
                for b_x, c_x, b_y, c_y in turns:
                    rows += [(b_x, c_x, b_y, c_y), (b_x, c_x, -b_y, -c_y)]
        return jax.vmap(self._path)(jnp.asarray(rows, self.length.dtype))

    def _path(self, coefficients: Float[Array, "4"]) -> Path:
        b_x, c_x, b_y, c_y = coefficients
        norm = jnp.hypot(c_x, c_y)
        cos, sin = c_x / norm, c_y / norm

        def curve(u):
            x, y = (b_x * u + c_x) * u, (b_y * u + c_y) * u
            return jnp.stack([cos * x + sin * y, cos * y - sin * x])

        return sample_by_arc_length(curve, self.length, self.num_samples)


class CubicCurves(ContinuousMotions):
    """Cubic Hermite curves with two parameters: the bearing and the heading of the end.

    This is the continuous counterpart of the spline sets, for CBTS without kernel trajectories. Zero
    parameters give a straight line.

    Settings: `bojax.motions.settings.CubicCurves`.
    """

    length: Float[Array, ""]
    bearing: Float[Array, ""]
    heading: Float[Array, ""]
    num_samples: int = eqx.field(static=True)

    @property
    @override
    def num_params(self) -> int:
        return 2

    @override
    def path(self, params: Float[Array, "D"]) -> Path:
        bearing = self.bearing * params[0]
        heading = 2.0 * bearing + self.heading * params[1]
        end = jnp.stack([jnp.cos(bearing), jnp.sin(bearing)])
        end_tangent = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        start_tangent = jnp.asarray([1.0, 0.0], params.dtype)

        def curve(u):
            return (
                u * (1.0 - u) ** 2 * start_tangent
                + u**2 * (3.0 - 2.0 * u) * end
                - u**2 * (1.0 - u) * end_tangent
            )

        return sample_by_arc_length(curve, self.length, self.num_samples)
