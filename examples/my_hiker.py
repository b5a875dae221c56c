"""A problem of my own with a belief of particles: a drone looks for a hiker by the distance to a phone."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.planning.base import Plan
from bojax.planning.belief_planner import BeliefPlanner
from bojax.problems.actions import Box
from bojax.problems.particles import Particles
from bojax.problems.state_space import StateProblem


class Hiker(StateProblem):
    """The state is the position of the drone, then that of the hiker, who strolls; lengths are in km."""

    noise: Float[Array, ""]  # standard deviation of the measured distance
    stroll: Float[Array, ""]  # standard deviation of a step of the hiker, along x and along y
    sight: Float[Array, ""]  # distance from which the drone sees the hiker
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True, default=30)

    @property
    @override
    def actions(self) -> Box:
        """The heading of the drone, which flies 1 km a step."""
        turn = jnp.full(1, jnp.pi, self.noise.dtype)
        return Box(-turn, turn, is_angle=True)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        """The drone at the origin, the hiker anywhere within 6 km along x and y."""
        hiker = jax.random.uniform(key, (2,), self.noise.dtype, -6.0, 6.0)
        return jnp.concatenate([jnp.zeros_like(hiker), hiker])

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "4"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "4"], Float[Array, ""], Bool[Array, ""]]:
        """The next state, the reward, and whether the hiker is found."""
        drone = state[:2] + jnp.concatenate([jnp.cos(action), jnp.sin(action)])
        hiker = state[2:] + self.stroll * jax.random.normal(key, (2,), state.dtype)
        state = jnp.concatenate([drone, hiker])
        is_found = distance(state) < self.sight
        return state, jnp.where(is_found, 100.0, -1.0).astype(state.dtype), is_found

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: Float[Array, "4"],
        action: Float[Array, "1"],
        next_state: Float[Array, "4"],
    ) -> Float[Array, "1"]:
        """The measured distance, which says nothing about the direction."""
        return distance(next_state) + self.noise * jax.random.normal(key, (1,), next_state.dtype)

    @override
    def log_likelihood(
        self,
        observation: Float[Array, "1"],
        state: Float[Array, "4"],
        action: Float[Array, "1"],
        next_state: Float[Array, "4"],
    ) -> Float[Array, ""]:
        """Logarithm of the density of a measured distance."""
        return norm.logpdf(observation[0], distance(next_state), self.noise)

    @override
    def heuristic_value(self, state: Float[Array, "4"]) -> Float[Array, ""]:
        """About the return of a drone that knows where the hiker is: an optimistic value of a leaf."""
        weight = self.discount ** jnp.maximum(distance(state) - self.sight, 0.0)
        return 100.0 * weight - (1.0 - weight) / (1.0 - self.discount)

    @override
    def sketch(self, state: Float[Array, "4"]) -> dict[str, Float[Array, "2"]]:
        """What pictures and films draw."""
        return {"drone": state[:2], "hiker": state[2:]}


class TowardsMean(BeliefPlanner):
    """Plans nothing: flies to where the hiker is on average."""

    @override
    def plan(self, key: Key[Array, ""], problem: StateProblem, belief: Particles) -> Plan:
        """The heading; no value is predicted."""
        x, y = belief.mean[2:] - belief.mean[:2]
        return Plan(jnp.arctan2(y, x)[None], None, jnp.full_like(x, jnp.nan), jnp.zeros((), jnp.int32))


def distance(state: Float[Array, "4"]) -> Float[Array, ""]:
    """Distance between drone and hiker."""
    return jnp.linalg.norm(state[2:] - state[:2])
