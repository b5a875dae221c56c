"""An environment of my own: push a puck along a rail into a pocket."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box


class Puck(Env):
    """A puck on a rail from -1 to 1, pushed left or right, with a random draught; the pocket is at the right.

    Every array field is a setting that can be swept; `eqx.field(static=True)` marks what fixes shapes.
    """

    push: Float[Array, ""]  # velocity gained by an action of 1, per step
    friction: Float[Array, ""]  # share of the velocity that is lost per step
    draught: Float[Array, ""]  # standard deviation of the velocity gained at random, per step
    max_steps: int = eqx.field(static=True, default=200)

    @property
    def observation_space(self) -> Box:
        """Position and velocity; learners scale observations by these bounds."""
        high = jnp.asarray([1.0, 0.1], self.push.dtype)
        return Box(-high, high)

    @property
    def action_space(self) -> Box:
        """The push."""
        one = jnp.ones((1,), self.push.dtype)
        return Box(-one, one)

    def reset(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        """A puck at rest, at a random position in the left half."""
        position = jax.random.uniform(key, (), self.push.dtype, -1.0, 0.0)
        return jnp.stack([position, jnp.zeros_like(position)])

    def step(
        self, key: Key[Array, ""], state: Float[Array, "2"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "2"], TimeStep]:
        """The puck bounces off the left end with half its speed, and is paid 1 when it reaches the pocket."""
        position, velocity = state
        gained = self.push * jnp.clip(action[0], -1.0, 1.0)
        gained = gained + self.draught * jax.random.normal(key, (), state.dtype)
        velocity = (1.0 - self.friction) * velocity + gained
        velocity = jnp.where(position + velocity < -1.0, -0.5 * velocity, velocity)
        after = jnp.stack([jnp.maximum(position + velocity, -1.0), velocity])
        success = after[0] > 1.0
        reward = success.astype(state.dtype)
        return after, TimeStep(after, reward, success, jnp.zeros_like(success), success)
