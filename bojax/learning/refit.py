"""The end of an episode of EMU-Q: its values fitted again to all transitions (Algorithm 6, lines 14-17).

The covariance S stays; the targets are those of the present policy pi. Either by sweeps,
m <- beta S Phi'(r + gamma Phi_next m), or by solving the equations that they converge to,
(I - beta gamma S Phi'Phi_next) m = beta S Phi'r. Features are computed a block of transitions at a time.
"""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action
from bojax.learning.memory import Memory
from bojax.numerics.lanes import any_lane
from bojax.numerics.linalg import matmul, solve

if TYPE_CHECKING:
    from bojax.learning.emu_q import EMUQ, EMUQState

Q, U = 0, 1
"""Columns of the mean."""


class _Policy(eqx.Module):
    """What is known of every transition once pi is fixed: a', and with it the parts of the targets of U."""

    chosen: Int[Array, "C"]
    trust: Float[Array, "C"]
    bonus: Float[Array, "C"]


def refit(
    learner: "EMUQ",
    key: Key[Array, ""],
    state: "EMUQState",
    kappa: Float[Array, ""],
    is_active: Bool[Array, ""],
) -> Float[Array, "M 2"]:
    """The mean of Q and U after an episode; where not active, that of before.

    First Q, with a' chosen anew by Q + kappa U for every sweep or every solution; then the exploration
    rewards by (5.12) and, with a' chosen once, U.
    """
    key_q, key_policy = jax.random.split(key)
    q = _fit_q(learner, key_q, state, kappa, is_active)
    mean = state.posterior.mean.at[:, Q].set(q)
    candidates, samples = learner.draw(key_policy, state)
    policy = _fix_policy(learner, state, mean, kappa, candidates, samples)
    return mean.at[:, U].set(_fit_u(learner, state, policy, candidates, mean[:, U], is_active))


def _fit_q(learner, key, state, kappa, is_active) -> Float[Array, "M"]:
    posterior, memory = state.posterior, state.memory
    dtype = posterior.mean.dtype
    gain = learner.noise_precision * posterior.base
    u = posterior.mean[:, U]

    def improve(loop):
        number, q, going = loop
        candidates, _ = learner.draw(jax.random.fold_in(key, number), state)
        ys = jax.vmap(state.features.action)(candidates)
        look = _looker(learner, state, ys, jnp.stack([q, u], axis=1))

        def rows_of(rows: Memory, is_there):
            values, trust = look(rows)
            values = values.at[:, :, U].multiply(trust)
            chosen = jnp.argmax(values[:, :, Q] + kappa * values[:, :, U], axis=1)
            goes_on = is_there if learner.terminal_q == "bootstrap" else is_there & ~rows.terminated
            value = jnp.take_along_axis(values[:, :, Q], chosen[:, None], axis=1)[:, 0]
            return chosen, value, learner.discount * goes_on.astype(dtype)

        def sweep(total, rows, index, is_there):
            del index
            _, value, weight = rows_of(rows, is_there)
            target = jnp.where(is_there, rows.rewards, 0.0) + weight * value
            return total + matmul(target, _features(state, rows))

        def equations(total, rows, index, is_there):
            del index
            chosen, _, weight = rows_of(rows, is_there)
            reward = jnp.where(is_there, rows.rewards, 0.0)
            return _accumulate(state, total, rows, ys[chosen], weight, reward)

        if learner.refit == "sweeps":
            after = matmul(gain, memory.fold(sweep, jnp.zeros_like(q), learner.refit_block))
        else:
            after = _solved(gain, memory.fold(equations, _nothing(q), learner.refit_block))
        change = jnp.linalg.norm(after - q)
        number = number + 1
        is_far = (change > learner.tolerance) & (number < learner.max_sweeps)
        return number, jnp.where(going, after, q), going & is_far

    start = jnp.zeros((), jnp.int32), posterior.mean[:, Q], is_active
    return jax.lax.while_loop(lambda loop: any_lane(loop[2]), improve, start)[1]


def _fix_policy(learner, state, mean, kappa, candidates: Action, samples: Action) -> _Policy:
    """Choose a' at every next state, and compute the exploration rewards there."""
    features, memory = state.features, state.memory
    capacity, dtype = len(memory.rewards), mean.dtype
    look = _looker(learner, state, jax.vmap(features.action)(candidates), mean)
    forms = jax.vmap(lambda a: features.split_both(state.posterior.base, features.action(a)))
    if learner.mixes_transitions:
        form = forms(samples)
    else:
        form = jnp.mean(forms(samples), axis=0)[None]

    def note(policy, rows, index, is_there):
        del is_there
        chosen, trusts, variances = policy
        values, trust = look(rows)
        values = values.at[:, :, U].multiply(trust)
        best = jnp.argmax(values[:, :, Q] + kappa * values[:, :, U], axis=1).astype(jnp.int32)
        x = jax.vmap(features.state)(rows.next_observations)
        variance = jax.vmap(lambda a: jnp.sum(matmul(x, a) * x, axis=1), out_axes=1)(form)
        trust = jnp.take_along_axis(trust, best[:, None], axis=1)[:, 0]
        place = index[0]
        return (
            jax.lax.dynamic_update_slice_in_dim(chosen, best, place, 0),
            jax.lax.dynamic_update_slice_in_dim(trusts, trust, place, 0),
            jax.lax.dynamic_update_slice_in_dim(variances, variance, place, 0),
        )

    start = (
        jnp.zeros((capacity,), jnp.int32),
        jnp.ones((capacity,), dtype),
        jnp.zeros((capacity, len(form)), dtype),
    )
    chosen, trust, variances = memory.fold(note, start, learner.refit_block)
    return _Policy(chosen, trust, learner.bonus(_mean_variance(variances, memory.count)))


def _mean_variance(variances: Float[Array, "C K"], count: Int[Array, ""]) -> Float[Array, "C"]:
    """Mean over the actions of each transition; with several, over the wrong ones.

    The published code takes the N x K variances, transition by transition, for a table of K rows of N, and
    averages its columns.
    """
    capacity, number = variances.shape
    if number == 1:
        return variances[:, 0]
    index, action = jnp.arange(capacity, dtype=jnp.int32), jnp.arange(number, dtype=jnp.int32)
    place = index[:, None] + action[None, :] * count
    return jnp.mean(variances.ravel().at[place].get(mode="fill", fill_value=0.0), axis=1)


def _fit_u(learner, state, policy: _Policy, candidates, u, is_active) -> Float[Array, "M"]:
    posterior, memory, features = state.posterior, state.memory, state.features
    ys = jax.vmap(features.action)(candidates)
    gain = learner.noise_precision * posterior.base
    dtype = u.dtype

    def parts(rows, index, is_there):
        """Reward, weight of the next value, and y(a')."""
        bonus, trust = policy.bonus[index], policy.trust[index]
        reward, weight = bonus, learner.discount * trust
        if learner.terminal_u != "bootstrap":
            weight = jnp.where(rows.terminated, 0.0, weight)
        if learner.terminal_u == "absorbing":
            reward = jnp.where(rows.terminated, bonus / (1.0 - learner.discount), bonus)
        zero = jnp.zeros((), dtype)
        return jnp.where(is_there, reward, zero), jnp.where(is_there, weight, zero), ys[policy.chosen[index]]

    def equations(total, rows, index, is_there):
        reward, weight, y = parts(rows, index, is_there)
        return _accumulate(state, total, rows, y, weight, reward)

    matrix, vector = memory.fold(equations, _nothing(u), learner.refit_block)
    if learner.refit == "direct":
        return jnp.where(is_active, _solved(gain, (matrix, vector)), u)
    # With a' fixed, a sweep is an affine map of the weights: one pass over the transitions is enough.
    matrix, vector = matmul(gain, matrix), matmul(gain, vector)

    def sweep(loop):
        number, u, going = loop
        after = vector + matmul(matrix, u)
        number = number + 1
        is_far = (jnp.linalg.norm(after - u) > learner.tolerance) & (number < learner.max_sweeps)
        return number, jnp.where(going, after, u), going & is_far

    start = jnp.zeros((), jnp.int32), u, is_active
    return jax.lax.while_loop(lambda loop: any_lane(loop[2]), sweep, start)[1]


def _looker(learner, state, ys: Float[Array, "J R"], mean: Float[Array, "M 2"]):
    """A function of some transitions: Q and U of every candidate at their next states, and the trust in U."""
    features = state.features
    weights = jax.vmap(lambda y: jax.vmap(features.split, (1, None), 1)(mean, y), out_axes=1)(ys)
    forms = None
    if learner.optimistic_u:
        forms = jax.vmap(lambda y: features.split_both(state.posterior.base, y))(ys)

    def look(rows: Memory) -> tuple[Float[Array, "B J 2"], Float[Array, "B J"]]:
        x = jax.vmap(features.state)(rows.next_observations)
        values = matmul(x, weights.reshape(weights.shape[0], -1)).reshape(len(x), -1, 2)
        if forms is None:
            return values, jnp.ones(values.shape[:2], values.dtype)
        variances = jax.vmap(lambda form: jnp.sum(matmul(x, form) * x, axis=1), out_axes=1)(forms)
        return values, learner.trust(variances)

    return look


def _features(state, rows: Memory) -> Float[Array, "B M"]:
    return jax.vmap(state.features)(rows.observations, rows.actions)


def _next_features(state, rows: Memory, y: Float[Array, "B R"]) -> Float[Array, "B M"]:
    x = jax.vmap(state.features.state)(rows.next_observations)
    return jax.vmap(state.features.join)(x, y)


def _nothing(weights: Float[Array, "M"]) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
    return jnp.zeros((len(weights), len(weights)), weights.dtype), jnp.zeros_like(weights)


def _accumulate(state, total, rows, y, weight, reward) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
    """Phi'(weight Phi_next) and Phi'reward, added up."""
    matrix, vector = total
    phi, phi_next = _features(state, rows), _next_features(state, rows, y)
    return matrix + matmul(phi.T, weight[:, None] * phi_next), vector + matmul(reward, phi)


def _solved(gain, total) -> Float[Array, "M"]:
    matrix, vector = total
    identity = jnp.eye(len(vector), dtype=vector.dtype)
    return solve(identity - matmul(gain, matrix), matmul(gain, vector)[:, None])[:, 0]
