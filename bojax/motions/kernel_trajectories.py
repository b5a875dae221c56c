"""Kernel trajectories: smooth paths through anchor points by kernel Bayes' rule (Sections 4.5-4.6)."""

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import erf
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.models.kernels import RBF
from bojax.motions.base import ContinuousMotions, Path, sample_by_arc_length
from bojax.numerics.linalg import matmul, solve_small


def posterior_coefficients(
    anchors: Float[Array, "N 2"],
    space_gram: Float[Array, "N N"],
    time_gram: Float[Array, "N N"],
    prior_embedding: Float[Array, "N"],
    epsilon: Float[Array, ""],
    delta: Float[Array, ""],
) -> Float[Array, "N 2"]:
    """C such that the expected position at time y is k_Y(y)' C: (4.7)-(4.9) for all times at once.

    (4.9) Lambda = diag((G_X + n epsilon I)^-1 m_pi); (4.8) w(y) = Lambda G_Y ((Lambda G_Y)^2 + delta I)^-1
    Lambda k_Y(y); (4.7) T(y) = X' w(y), over all anchors, the first included (the sum is printed from 1).
    """
    num = anchors.shape[0]
    eye = jnp.eye(num, dtype=anchors.dtype)
    weights = solve_small(space_gram + num * epsilon * eye, prior_embedding[:, None])[:, 0]
    a = weights[:, None] * time_gram
    # X' A (A^2 + delta I)^-1 Lambda k = (Lambda (A^2 + delta I)^-T A' X)' k
    return weights[:, None] * solve_small((matmul(a, a) + delta * eye).T, matmul(a.T, anchors))


class KernelTrajectories(ContinuousMotions):
    """Kernel trajectories from equally spaced anchor points, with one turning angle per segment (Fig. 4.1).

    Trajectories are computed in the robot's frame, because the weighted sum of world positions in (4.7) would
    shrink towards the origin of the world frame. The uniform prior of Section 4.6 covers the square of all
    points within one length along each axis; its mean embedding is computed in closed form instead of from
    samples.

    With `start="pose"` the start and its heading are imposed, with `start="relaxed"` only the start (Fig.
    4.2d). The curve is then scaled to `length`.

    Settings: `bojax.motions.settings.KernelTrajectories`.
    """

    length: Float[Array, ""]
    first_angle: Float[Array, ""]
    turn_angle: Float[Array, ""]
    space_lengthscale: Float[Array, ""]
    time_lengthscale: Float[Array, ""]
    epsilon: Float[Array, ""]
    delta: Float[Array, ""]
    num_segments: int = eqx.field(static=True)
    start: Literal["pose", "relaxed"] = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)

    @property
    @override
    def num_params(self) -> int:
        return self.num_segments

    def anchors(self, params: Float[Array, "D"]) -> Float[Array, "N 2"]:
        """Anchor points for a trajectory of length 1, the robot's position first (Fig. 4.1)."""
        is_first = jnp.arange(self.num_segments) == 0
        turns = jnp.where(is_first, self.first_angle, self.turn_angle) * params
        heading = jnp.cumsum(turns)
        steps = jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1) / self.num_segments
        return jnp.concatenate([jnp.zeros((1, 2), params.dtype), jnp.cumsum(steps, axis=0)])

    @override
    @eqx.filter_jit  # traced and lowered once for all the places of a planner that need a path
    def path(self, params: Float[Array, "D"]) -> Path:
        return sample_by_arc_length(self.curve(params), self.length, self.num_samples)

    def curve(self, params: Float[Array, "D"]) -> Callable[[Float[Array, ""]], Float[Array, "2"]]:
        """The trajectory as a function of time in [0, 1], before it is scaled to `length` (4.7)."""
        anchors = self.anchors(params)
        times = jnp.linspace(0.0, 1.0, self.num_segments + 1, dtype=params.dtype)
        space, time = RBF(self.space_lengthscale), RBF(self.time_lengthscale)
        coefficients = posterior_coefficients(
            anchors,
            space.gram(anchors, anchors),
            time.gram(times[:, None], times[:, None]),
            _uniform_embedding(anchors, self.space_lengthscale),
            self.epsilon,
            self.delta,
        )

        def expected(u):
            return matmul(time.gram(u[None, None], times[:, None])[0], coefficients)

        # Because of the regularisation in (4.8)-(4.9), the raw curve starts slightly off the robot's position
        # and heading, whatever anchors are added. T(y) - T(0) + (e_x - T'(0)) y (1-y)^2 starts at the robot,
        # tangential to its heading, and has the same end relative to its start; without the last term, only
        # the position is imposed.
        zero, one = jnp.zeros((), params.dtype), jnp.ones((), params.dtype)
        origin, velocity = eqx.filter_jvp(expected, (zero,), (one,))
        misfit = jnp.asarray([1.0, 0.0], params.dtype) - velocity
        if self.start == "relaxed":
            misfit = jnp.zeros_like(misfit)

        def curve(u):
            return expected(u) - origin + u * (1.0 - u) ** 2 * misfit

        return curve


def _uniform_embedding(points: Float[Array, "N 2"], lengthscale: Float[Array, ""]) -> Float[Array, "N"]:
    """E[k(x, U)] for U uniform on [-1, 1]^2 and the squared exponential kernel."""
    scaled = 1.0 / (2.0**0.5 * lengthscale)
    by_axis = (jnp.pi**0.5 / (4.0 * scaled)) * (erf((1.0 - points) * scaled) + erf((1.0 + points) * scaled))
    return by_axis[:, 0] * by_axis[:, 1]
