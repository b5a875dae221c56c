"""Estimates of the value of a new belief of a tree."""

import abc
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Num
from typing_extensions import override

from bojax.numerics.lanes import any_lane, in_own_kernel
from bojax.numerics.simulation_keys import random_index
from bojax.planning.oracles import policy_named
from bojax.problems.particles import Particles
from bojax.problems.state_space import StateProblem

Policy = Callable[[StateProblem, Key[Array, ""], Particles], Float[Array, "K"]]
"""An action for a belief: see `bojax.planning.oracles`."""

S = TypeVar("S")  # what a simulation goes on from: states, or a belief


class ParticleSet(eqx.Module):
    """A belief of a few states of equal weight."""

    states: Float[Array, "M D"]
    alive: Bool[Array, "M"]  # which of them are not terminal

    def weighted(self) -> Particles:
        """The same belief with weights, which are 0 for terminal states."""
        num_alive = jnp.sum(self.alive, dtype=self.states.dtype)
        log_weights = jnp.where(self.alive, -jnp.log(jnp.maximum(num_alive, 1.0)), -jnp.inf)
        return Particles(self.states, log_weights, ~self.alive)


class LeafValue(eqx.Module):
    """An estimate of the value of a belief: states of equal weight."""

    @abc.abstractmethod
    def __call__(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        states: Float[Array, "M D"],
        alive: Bool[Array, "M"],
        remaining: Int[Array, ""],
    ) -> Float[Array, ""]:
        """The value if `remaining` actions are left; states that are not `alive` are terminal.

        At the horizon, `remaining` is 0: a rollout has no actions, the value of a state is as elsewhere.
        """


class StateValue(LeafValue):
    """Mean value of the states if states were observed, `StateProblem.heuristic_value`."""

    @override
    def __call__(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        states: Float[Array, "M D"],
        alive: Bool[Array, "M"],
        remaining: Int[Array, ""],
    ) -> Float[Array, ""]:
        values = jax.vmap(problem.heuristic_value)(states)
        if values is None:
            name = type(problem).__name__
            raise ValueError(
                "planner.leaf_value: got state-value; allowed: a problem with a heuristic_value, which "
                f"{name} does not have"
            )
        return jnp.mean(jnp.where(alive, values, 0.0))


class Rollout(LeafValue):
    """Mean return of simulations of a policy, each from a random state of the belief, to the horizon."""

    # Policy that acts on a belief of one state; None for random actions
    policy: Policy | None = eqx.field(static=True, default=None, converter=policy_named)
    num_rollouts: int = eqx.field(static=True, default=1)  # number of simulations

    @override
    def __call__(
        self,
        key: Key[Array, ""],
        problem: StateProblem,
        states: Float[Array, "M D"],
        alive: Bool[Array, "M"],
        remaining: Int[Array, ""],
    ) -> Float[Array, ""]:
        key_start, key_rollout = jax.random.split(key)
        starts = jax.vmap(draw_alive, (0, None))(jax.random.split(key_start, self.num_rollouts), alive)

        def act(key, state):
            key_action, key_step = jax.random.split(key)
            if self.policy is None:
                action = problem.actions.decode(problem.actions.sample(key_action))
            else:
                known = Particles(state[None], jnp.zeros((1,), state.dtype), jnp.zeros((1,), bool))
                action = self.policy(problem, key_action, known)
            return problem.step(key_step, state, action)

        def act_in_all(key, state):
            return jax.vmap(act)(jax.random.split(key, self.num_rollouts), state)

        total = jnp.zeros((self.num_rollouts,), states.dtype)
        returns = simulated_return(
            key_rollout, act_in_all, states[starts], total, problem.discount, remaining
        )
        return jnp.mean(returns)


def simulated_return(
    key: Key[Array, ""],
    act: Callable[[Key[Array, ""], S], tuple[S, Float[Array, "*R"], Bool[Array, "*R"]]],
    start: S,
    total: Float[Array, "*R"],
    discount: Float[Array, ""],
    remaining: Int[Array, ""],
) -> Float[Array, "*R"]:
    """Discounted sums of the rewards of simulations, each to its end or to the horizon.

    `act` returns the next state of all simulations, their rewards, and whether they have ended. The sums in
    `total`, before the first action, are zeros, and `remaining` actions are left to the horizon.
    """

    def is_active(carry):
        return any_lane(jnp.any(in_own_kernel(carry[2], carry[0])))

    def next_step(carry):
        step, state, active, weight, total = carry
        state, reward, ended = act(jax.random.fold_in(key, step), state)
        total = total + jnp.where(active, weight * reward, 0.0)
        active = active & ~ended & (step + 1 < remaining)
        return step + 1, state, active, weight * discount, total

    active = jnp.broadcast_to(remaining > 0, total.shape)
    carry = jnp.zeros((), jnp.int32), start, active, jnp.ones((), total.dtype), total
    return jax.lax.while_loop(is_active, next_step, carry)[-1]


def draw_alive(key: Key[Array, ""], alive: Bool[Array, "M"]) -> Int[Array, ""]:
    """Index of a uniform draw among the states that are not terminal; of the last state if all are."""
    counts = prefix_sums(alive.astype(jnp.int32))
    choice = random_index(key, counts[-1])
    return jnp.minimum(jnp.sum(counts <= choice, dtype=jnp.int32), alive.shape[0] - 1)


def prefix_sums(values: Num[Array, "M"]) -> Num[Array, "M"]:
    """`cumsum` of a few numbers, as one sum over all pairs."""
    # XLA computes `cumsum` on a CPU by windows, whose bounds it checks at every element.
    index = jnp.arange(values.shape[0], dtype=jnp.int32)
    return jnp.sum(jnp.where(index[None] <= index[:, None], values[None], 0), axis=1, dtype=values.dtype)
