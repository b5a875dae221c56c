"""Light dark in several dimensions, with one or more agents (AGMCTS, arXiv 2503.12181)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Balls
from bojax.problems.pomdp.readings import GaussianReading, ReadingProblem
from bojax.results.outline import Outline


class LightDarkNd(ReadingProblem):
    """Agents that start about the origin and must all reach a goal, past a ring of negative reward.

    A state is the position of each agent. The first agent observes its position relative to a beacon, every
    other one relative to the agent before it, with noise that grows with the distance d between them.
    Rewards of the agents are averaged. The goal is on the last axis, and the beacon beside the midpoint, on
    the first.

    Settings: `bojax.problems.pomdp.settings.LightDarkNd`.
    """

    start_radius: Float[Array, ""]
    goal_distance: Float[Array, ""]
    goal_tolerance: Float[Array, ""]
    beacon_offset: Float[Array, ""]
    action_radius: Float[Array, ""]
    process_noise: Float[Array, ""]
    noise_scale: Float[Array, ""]
    noise_power: Float[Array, ""]
    max_noise: Float[Array, ""]
    distance_reward: Float[Array, ""]
    goal_reward: Float[Array, ""]
    ring_reward: Float[Array, ""]
    discount: Float[Array, ""]
    num_dims: int = eqx.field(static=True)
    num_agents: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @override
    def sketch(self, state: Float[Array, "D"]) -> dict[str, Float[Array, "2"]]:
        """The first and the last coordinate of the beacon and of every agent."""
        agents = state.reshape(self.num_agents, self.num_dims)
        names = ["agent"] if self.num_agents == 1 else [f"agent {i + 1}" for i in range(self.num_agents)]
        places = jnp.concatenate([self._beacon()[None], agents])[:, jnp.asarray([0, -1])]
        return dict(zip(["beacon", *names], places, strict=True))

    @override
    def outline(self) -> Outline:
        return Outline(goals=[(0.0, self.goal_distance, self.goal_tolerance)])

    @property
    @override
    def actions(self) -> Balls:
        return Balls(self.action_radius, self.num_agents, self.num_dims)

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "D"]:
        direction = jax.random.normal(key, (self.num_agents, self.num_dims), self.discount.dtype)
        return (self.start_radius * direction / _lengths(direction)[:, None]).ravel()

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "D"], action: Float[Array, "D"]
    ) -> tuple[Float[Array, "D"], Float[Array, ""], Bool[Array, ""]]:
        noise = self.process_noise * jax.random.normal(key, state.shape, state.dtype)
        next_state = state + action + noise
        distance = self._goal_distances(next_state)
        ended = jnp.all(distance < self.goal_tolerance)
        width = 0.5 * self.goal_tolerance
        ring = jnp.exp(-0.5 * ((distance - 10.0 * width) / (2.0 * width)) ** 2)
        goal = jnp.where(ended, jnp.exp(-0.5 * (distance / width) ** 2), 0.0)
        reward = self.distance_reward * distance**2 + self.ring_reward * ring + self.goal_reward * goal
        return next_state, jnp.mean(reward), ended

    def _goal_distances(self, state: Float[Array, "D"]) -> Float[Array, "N"]:
        goal = jnp.zeros(self.num_dims, state.dtype).at[-1].set(self.goal_distance)
        return _lengths(state.reshape(self.num_agents, self.num_dims) - goal[None])

    def _beacon(self) -> Float[Array, "P"]:
        beacon = jnp.zeros(self.num_dims, self.discount.dtype).at[-1].set(0.5 * self.goal_distance)
        return beacon.at[0].add(self.beacon_offset)

    @override
    def reading(self, action: Float[Array, "D"], next_state: Float[Array, "D"]) -> GaussianReading:
        positions = next_state.reshape(self.num_agents, self.num_dims)
        offsets = positions - jnp.concatenate([self._beacon()[None], positions[:-1]])
        distance = _lengths(offsets)
        noise = jnp.minimum(self.max_noise, self.noise_scale * (distance + distance**self.noise_power))
        return GaussianReading(offsets.ravel(), jnp.repeat(noise, self.num_dims))


def _lengths(vectors: Float[Array, "N D"]) -> Float[Array, "N"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=1))
