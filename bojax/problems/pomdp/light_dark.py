"""Light Dark on integers: localise in the light, then stop at 0 (Sunberg and Kochenderfer, ICAPS 2018)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.models.checks import compiled_if_known
from bojax.problems import particles
from bojax.problems.actions import Discrete
from bojax.problems.particles import Particles
from bojax.problems.pomdp.readings import GaussianReading, ReadingProblem
from bojax.results.outline import Outline

MAX_REPLACED = 0.05
"""Largest share of particles that the published filter replaces after an observation."""


class LightDark(ReadingProblem):
    """A position that is clamped to [-radius, radius], and moves of 10, 1 or 0; the move 0 ends the episode.

    The standard deviation of an observation grows with the distance of the new position from the light.

    Settings: `bojax.problems.pomdp.settings.LightDark`.
    """

    moves: Float[Array, "A"]
    light: Float[Array, ""]
    least_noise: Float[Array, ""]
    stop_reward: Float[Array, ""]
    wrong_stop_reward: Float[Array, ""]
    step_reward: Float[Array, ""]
    discount: Float[Array, ""]
    radius: int = eqx.field(static=True)
    start_radius: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    belief_update: Literal["bootstrap", "published"] = eqx.field(
        static=True, default="bootstrap", kw_only=True
    )
    # Optimal value of each action at each integer from -radius, with states observed; None to compute it
    action_values: Float[Array, "S A"] | None = None

    def __post_init__(self) -> None:
        if self.action_values is None:
            self.action_values = self._solved()

    @compiled_if_known
    def _solved(self) -> Float[Array, "S A"]:
        """Values of actions: fewer moves than there are states lead anywhere."""
        states = jnp.arange(-self.radius, self.radius + 1, dtype=jnp.int32).astype(self.discount.dtype)
        step = jax.vmap(jax.vmap(self._step, (None, 0)), (0, None))
        next_states, rewards, ended = step(states, self.moves)

        def sweep(_: Int[Array, ""], values: Float[Array, "S"]) -> Float[Array, "S"]:
            return jnp.max(self._backed_up(values, next_states, rewards, ended), axis=1)

        values = jax.lax.fori_loop(0, states.shape[0], sweep, jnp.full_like(states, self.wrong_stop_reward))
        return self._backed_up(values, next_states, rewards, ended)

    @override
    def sketch(self, state: Float[Array, "1"]) -> dict[str, Float[Array, "1"]]:
        return {"light": self.light[None], "position": state}

    @override
    def outline(self) -> Outline:
        return Outline(goals=[(0.0, -0.5, self.max_steps, 0.5)])

    @property
    @override
    def actions(self) -> Discrete:
        return Discrete(self.moves[:, None])

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "1"]:
        start = jax.random.randint(key, (1,), -self.start_radius, self.start_radius + 1, jnp.int32)
        return start.astype(self.discount.dtype)

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "1"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "1"], Float[Array, ""], Bool[Array, ""]]:
        next_state, reward, ended = self._step(state[0], action[0])
        return next_state[None], reward, ended

    @override
    def reading(self, action: Float[Array, "1"], next_state: Float[Array, "1"]) -> GaussianReading:
        return GaussianReading(next_state, self.noise_at(next_state))

    @override
    def filter(
        self,
        key: Key[Array, ""],
        belief: Particles,
        action: Float[Array, "1"],
        observation: Float[Array, "1"],
    ) -> tuple[Particles, Bool[Array, ""]]:
        """The bootstrap filter; in the published results, some particles are then replaced.

        Up to `MAX_REPLACED` of the particles, at random, are replaced, fewer the nearer the largest
        likelihood is to the density at the mode of an observation from `observation`. As in the published
        code, a new particle is `observation` plus another observation from there, so that it is about twice
        `observation`; this changes the returns.
        """
        if self.belief_update == "bootstrap":
            return super().filter(key, belief, action, observation)
        propagate_key, condition_key, choice_key, noise_key = jax.random.split(key, 4)
        moved, _ = particles.propagate(self, propagate_key, belief, action)
        after, collapsed = particles.condition(self, condition_key, belief, action, moved, observation)
        likelihood = jax.vmap(self.log_likelihood, (None, 0, None, 0))
        largest = jnp.max(likelihood(observation, belief.states, action, moved.states))
        noise = self.noise_at(observation)
        ratio = jnp.exp(largest - norm.logpdf(0.0, 0.0, noise[0]))
        count = after.states.shape[0]
        num_replaced = jnp.floor(MAX_REPLACED * jnp.maximum(0.0, 1.0 - ratio) * count)
        chosen = jax.random.permutation(choice_key, jnp.arange(count, dtype=noise.dtype)) < num_replaced
        drawn = 2.0 * observation[None] + noise[None] * jax.random.normal(noise_key, (count, 1), noise.dtype)
        replaced = jnp.clip(jnp.round(drawn), -self.radius, self.radius)
        states = jnp.where((chosen & ~collapsed)[:, None], replaced, after.states)
        return Particles(states, after.log_weights, after.terminal), collapsed

    @override
    def heuristic_value(self, state: Float[Array, "1"]) -> Float[Array, ""]:
        return jnp.max(self.values_at(state))

    def values_at(self, state: Float[Array, "1"]) -> Float[Array, "A"]:
        """Optimal value of each action with states observed."""
        assert self.action_values is not None
        return self.action_values[state[0].astype(jnp.int32) + self.radius]

    def noise_at(self, state: Float[Array, "1"]) -> Float[Array, "1"]:
        """Standard deviation of an observation from a position."""
        return jnp.abs(state - self.light) + self.least_noise

    def _step(
        self, state: Float[Array, ""], move: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
        stops = move == 0.0
        stop_reward = jnp.where(state == 0.0, self.stop_reward, self.wrong_stop_reward)
        reward = jnp.where(stops, stop_reward, self.step_reward)
        return jnp.clip(state + move, -self.radius, self.radius), reward, stops

    def _backed_up(
        self,
        values: Float[Array, "S"],
        next_states: Float[Array, "S A"],
        rewards: Float[Array, "S A"],
        ended: Bool[Array, "S A"],
    ) -> Float[Array, "S A"]:
        after = values[next_states.astype(jnp.int32) + self.radius]
        return rewards + self.discount * jnp.where(ended, 0.0, after)
