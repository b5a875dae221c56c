"""Mountain car whose velocity is not observed: a position that is measured with noise."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Box
from bojax.problems.pomdp.readings import GaussianReading, ReadingProblem

LOW, HIGH = (-1.2, -0.07), (0.6, 0.07)
"""Bounds of position and velocity, which also limit the motion."""


class PomdpMountainCar(ReadingProblem):
    """Build momentum to drive a weak car up a hill, with rewards of 1 at the goal and 0 elsewhere.

    A state is the position and the velocity per step, an action the fraction of the full force. Noise on the
    velocity keeps the particles of a belief apart. An episode begins at rest in [-0.6, -0.4].

    Settings: `bojax.problems.pomdp.settings.PomdpMountainCar`.
    """

    goal_position: Float[Array, ""]
    power: Float[Array, ""]
    gravity: Float[Array, ""]
    velocity_noise: Float[Array, ""]
    sensor_noise: Float[Array, ""]
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def actions(self) -> Box:
        one = jnp.ones(1, self.power.dtype)
        return Box(-one, one)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "2"]:
        position = jax.random.uniform(key, (), self.power.dtype, -0.6, -0.4)
        return jnp.stack([position, jnp.zeros_like(position)])

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "2"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "2"], Float[Array, ""], Bool[Array, ""]]:
        velocity_change = action[0] * self.power + self.velocity_noise * jax.random.normal(
            key, (), state.dtype
        )
        next_state = roll(state, velocity_change, self.gravity)
        is_there = next_state[0] >= self.goal_position
        return next_state, is_there.astype(state.dtype), is_there

    @override
    def reading(self, action: Float[Array, "1"], next_state: Float[Array, "2"]) -> GaussianReading:
        return GaussianReading(next_state[:1], self.sensor_noise)

    @override
    def sketch(self, state: Float[Array, "2"]) -> dict[str, Float[Array, "1"]]:
        return {"position": state[:1]}


def roll(
    state: Float[Array, "2"], velocity_change: Float[Array, ""], gravity: Float[Array, ""]
) -> Float[Array, "2"]:
    """Update the velocity, then the position, in a valley of height sin(3 x); the left wall stops the car."""
    velocity = state[1] + (velocity_change - gravity * jnp.cos(3.0 * state[0]))
    velocity = jnp.clip(velocity, LOW[1], HIGH[1])
    position = jnp.clip(state[0] + velocity, LOW[0], HIGH[0])
    at_the_wall = (position == LOW[0]) & (velocity < 0.0)
    return jnp.stack([position, jnp.where(at_the_wall, jnp.zeros_like(velocity), velocity)])
