"""A belief as an environment: a learner acts on what a filter knows about the state of a POMDP."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box, Discrete, Space
from bojax.numerics.linalg import matmul
from bojax.problems import actions
from bojax.problems.particles import Particles
from bojax.problems.state_checks import check_model
from bojax.problems.state_space import COLLAPSES, Observed, StateProblem
from bojax.results.schema import Table

Features = Literal["mean-and-spread", "mean", "reading", "state"]


class Tracked(eqx.Module):
    """The state of the environment."""

    world: Float[Array, "D"]  # true state of the problem
    belief: Particles  # belief of the filter
    # The last observation of the problem; the middle of the bounds before the first
    reading: Float[Array, "O"]


class BeliefEnv(Env):
    """A state problem and the filter of its belief; what is observed is a summary of the belief.

    The summary is the mean and the standard deviation of every component of the state, or the mean alone. For
    comparison, it may be the last observation alone, without a filter, or the true state. Actions are the
    parameters in [-1, 1] of those of the problem, or their number in its list. A step that ends the episode
    with a positive reward is a success.

    The belief comes from a filter, which the learner influences only by its actions, so that these
    summaries are the state of a Markov decision process only as far as they describe the belief. How often it
    has collapsed in training is a column of `runs.parquet`, as of a planner.

    Settings: `bojax.envs.settings.Belief`.
    """

    count_columns: ClassVar[Table] = (COLLAPSES,)

    problem: StateProblem
    low: Float[Array, "D"]  # lower bounds of the state's components, or of the observation's with `reading`
    high: Float[Array, "D"]  # upper bounds of them
    features: Features = eqx.field(static=True)  # what is observed
    max_steps: int = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        """Take the time limit of the problem."""
        self.max_steps = self.problem.max_steps

    def __check_init__(self):
        """Check the problem and the number of bounds, or raise ValueError."""
        if not isinstance(self.problem, StateProblem):
            name = type(self.problem).__name__
            raise ValueError(f"env.problem: got {name}; allowed: a problem with a belief of particles")
        check_model(self.problem)
        state = eqx.filter_eval_shape(type(self).reset, self, jax.random.key(0))
        num = (state.reading if self.features == "reading" else state.world).size
        for name, bounds in (("low", self.low), ("high", self.high)):
            if bounds.size != num:
                raise ValueError(f"env.{name}: got {bounds.size} numbers; allowed: {num}")

    @property
    @override
    def observation_space(self) -> Box:
        if self.features != "mean-and-spread":
            return Box(self.low, self.high)
        # The standard deviation of a uniform distribution between the bounds.
        largest = (self.high - self.low) / jnp.sqrt(jnp.asarray(12.0, self.low.dtype))
        return Box(
            jnp.concatenate([self.low, jnp.zeros_like(self.low)]), jnp.concatenate([self.high, largest])
        )

    @property
    @override
    def action_space(self) -> Space:
        space = self.problem.actions
        if isinstance(space, actions.Discrete):
            return Discrete(space.count)
        one = jnp.ones(space.size, self.low.dtype)
        return Box(-one, one)

    @override
    def reset(self, key: Key[Array, ""]) -> Tracked:
        key_world, key_belief, key_reading = jax.random.split(key, 3)
        world = self.problem.initial(key_world)
        belief = self.problem.prior(key_belief, world, 1)
        action = self._decoded(self.action_space.example)
        shape = jax.eval_shape(self.problem.observe, key_reading, world, action, world).shape
        middle = 0.5 * (self.low + self.high)
        reading = middle if middle.shape == shape else jnp.zeros(shape, world.dtype)
        return Tracked(world, belief, reading)

    @override
    def observe(self, state: Tracked) -> Float[Array, "F"]:
        if self.features == "state":
            return state.world
        if self.features == "reading":
            return state.reading
        mean = state.belief.mean
        if self.features == "mean":
            return mean
        squares = (state.belief.states - mean[None]) ** 2
        return jnp.concatenate([mean, jnp.sqrt(matmul(jnp.exp(state.belief.log_weights), squares))])

    @override
    def counts(self, state: Tracked) -> dict[str, Int[Array, ""]]:
        assert state.belief.collapses is not None
        return {COLLAPSES.name: state.belief.collapses}

    @override
    def step(self, key: Key[Array, ""], state: Tracked, action: Array) -> tuple[Tracked, TimeStep]:
        key_step, key_observe, key_filter = jax.random.split(key, 3)
        decoded = self._decoded(action)
        world, reward, terminated = self.problem.step(key_step, state.world, decoded)
        reading = self.problem.observe(key_observe, state.world, decoded, world)
        belief = self.problem.update(state.belief, decoded, Observed(reading, terminated), key_filter)
        after = Tracked(world, belief, reading)
        never = jnp.zeros((), bool)
        success: Bool[Array, ""] = terminated & (reward > 0.0)
        return after, TimeStep(self.observe(after), reward, terminated, never, success)

    def _decoded(self, action: Array) -> Float[Array, "K"]:
        """The action of the problem."""
        if isinstance(self.action_space, Discrete):
            return self.problem.actions.decode(action[None])
        return self.problem.actions.decode(jnp.clip(action, -1.0, 1.0).astype(self.low.dtype))
