"""A problem of my own with a belief of particles: catch a buoy that drifts and is seen badly from afar."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Key

from bojax.problems.actions import Box
from bojax.problems.state_space import StateProblem


class Chase(StateProblem):
    """A boat moves by up to 1 m along x and y; it catches the buoy within `catch_radius`.

    The state is the position of the boat, then that of the buoy. The boat observes the offset of the buoy,
    with noise that grows with the distance. Every method is written for one state.
    """

    catch_radius: Float[Array, ""]  # m
    drift: Float[Array, ""]  # standard deviation of a step of the buoy, m
    noise: Float[Array, ""]  # standard deviation of the offset, by metre of distance
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True, default=30)

    @property
    def actions(self) -> Box:
        """The moves of the boat."""
        return Box(-jnp.ones(2, self.drift.dtype), jnp.ones(2, self.drift.dtype))

    def initial(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        """The boat at the origin, the buoy anywhere within 5 m along x and y."""
        buoy = jax.random.uniform(key, (2,), self.drift.dtype, -5.0, 5.0)
        return jnp.concatenate([jnp.zeros_like(buoy), buoy])

    def step(
        self, key: Key[Array, ""], state: Float[Array, "4"], action: Float[Array, "2"]
    ) -> tuple[Float[Array, "4"], Float[Array, ""], Bool[Array, ""]]:
        """The next state, the reward, and whether the episode ends."""
        boat = state[:2] + action
        buoy = state[2:] + self.drift * jax.random.normal(key, (2,), state.dtype)
        is_caught = jnp.linalg.norm(buoy - boat) <= self.catch_radius
        return jnp.concatenate([boat, buoy]), jnp.where(is_caught, 20.0, -1.0).astype(state.dtype), is_caught

    def observe(
        self,
        key: Key[Array, ""],
        state: Float[Array, "4"],
        action: Float[Array, "2"],
        next_state: Float[Array, "4"],
    ) -> Float[Array, "2"]:
        """The offset of the buoy from the boat, measured."""
        offset = next_state[2:] - next_state[:2]
        return offset + self.deviation(next_state) * jax.random.normal(key, (2,), offset.dtype)

    def log_likelihood(
        self,
        observation: Float[Array, "2"],
        state: Float[Array, "4"],
        action: Float[Array, "2"],
        next_state: Float[Array, "4"],
    ) -> Float[Array, ""]:
        """Logarithm of the density of an observation; a filter weighs its particles by it."""
        offset = next_state[2:] - next_state[:2]
        return jnp.sum(norm.logpdf(observation, offset, self.deviation(next_state)))

    def deviation(self, state: Float[Array, "4"]) -> Float[Array, ""]:
        """Standard deviation of the measured offset."""
        return 0.1 + self.noise * jnp.linalg.norm(state[2:] - state[:2])
