"""The least that a user writes for a problem of their own: a start and the outcome of a path."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.problems.pose import Outcome, PoseProblem


class GoalDisc(PoseProblem):
    """Reach a disc around the origin; each step costs the distance to it."""

    radius: Float[Array, ""]
    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    max_steps: int = eqx.field(static=True)

    def start(self, key: Key[Array, ""]) -> Pose:
        bearing = jax.random.uniform(key, (), self.radius.dtype, 0.0, 2.0 * jnp.pi)
        return jnp.stack([2.0 * jnp.cos(bearing), 2.0 * jnp.sin(bearing), bearing + jnp.pi])

    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        del start
        distance = jnp.sqrt(jnp.sum(path[:, :2] ** 2, axis=-1))
        is_there = distance <= self.radius
        success = jnp.any(is_there)
        last = jnp.where(success, jnp.argmax(is_there), path.shape[0] - 1)
        reward = jnp.where(success, 1.0, -distance[-1])
        return Outcome(reward, success, success, jnp.zeros((), bool), last)


def goal_disc(noise: float = 0.05, max_steps: int = 5) -> GoalDisc:
    numbers = (jnp.asarray(value, jnp.float64) for value in (0.3, noise, noise))
    return GoalDisc(*numbers, max_steps=max_steps)
