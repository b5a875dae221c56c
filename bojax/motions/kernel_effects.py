"""What each of the two kernels of kernel trajectories governs (Section 4.6)."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar

from bojax.motions.kernel_trajectories import KernelTrajectories
from bojax.numerics.angles import wrap_to_pi

NUM_INTERVALS = 64
"""Number of intervals of time, whose middles are the times at which a trajectory is measured."""

FACTOR = 0.5
"""Factor of a lengthscale, to see what its kernel changes."""


def kernel_effects(motions: KernelTrajectories, params: Float[Array, "D"]) -> dict[str, Scalar]:
    """Which kernel changes the speed, the acceleration and the turns of a trajectory more.

    Section 4.6: "Space constraints such as steering angle are determined by the space kernel kx while
    velocity and acceleration are governed by the time kernel ky." Each lengthscale is multiplied by `FACTOR`,
    one at a time. The effect of a kernel on a quantity is the root mean square of its change over the
    trajectory, and the result is the natural logarithm of a ratio: the effect of the kernel that the
    thesis names over the effect of the other; NaN if either has no effect.
    """
    before = _profile(motions, params)
    by_time = dataclasses.replace(motions, time_lengthscale=FACTOR * motions.time_lengthscale)
    by_space = dataclasses.replace(motions, space_lengthscale=FACTOR * motions.space_lengthscale)

    def effects(changed: KernelTrajectories) -> dict[str, Scalar]:
        after = _profile(changed, params)
        return {name: jnp.sqrt(jnp.mean((after[name] - before[name]) ** 2)) for name in before}

    time, space = effects(by_time), effects(by_space)
    return {
        "speed_by_time": _log_ratio(time["speed"], space["speed"]),
        "acceleration_by_time": _log_ratio(time["acceleration"], space["acceleration"]),
        "turns_by_space": _log_ratio(space["turns"], time["turns"]),
    }


def _log_ratio(one: Scalar, other: Scalar) -> Scalar:
    return jnp.where((one > 0.0) & (other > 0.0), jnp.log(one / other), jnp.nan)


def _profile(motions: KernelTrajectories, params: Float[Array, "D"]) -> dict[str, Float[Array, "..."]]:
    """Speed and its rate of change over time, and turns per metre between poses at equal arc lengths."""
    curve, dtype = motions.curve(params), motions.length.dtype
    one = jnp.ones((), dtype)

    def speed(u):
        _, velocity = jax.jvp(curve, (u,), (one,))
        return jnp.sqrt(jnp.sum(velocity**2))

    times = (jnp.arange(NUM_INTERVALS, dtype=dtype) + 0.5) / NUM_INTERVALS
    speeds, accelerations = jax.vmap(lambda u: jax.jvp(speed, (u,), (one,)))(times)
    # The trajectory has a duration of 1, so that its mean speed is the arc length of the curve.
    scale = motions.length / jnp.mean(speeds)
    heading = motions.path(params)[:, 2]
    turns = wrap_to_pi(jnp.diff(heading)) * (heading.shape[0] / motions.length)
    return {"speed": scale * speeds, "acceleration": scale * accelerations, "turns": turns}
