"""The fit of Q and U to all transitions at the end of an episode of EMU-Q (Algorithm 6, lines 14 to 17).

The covariance S stays the same; the TD targets are those of the current policy pi. The means are fitted
either by sweeps, m <- beta S Phi'(r + gamma Phi_next m), or by solving the equations that the sweeps converge
to, (I - beta gamma S Phi'Phi_next) m = beta S Phi'r. Features are computed a block of transitions at a time.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action
from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.memory import Memory
from bojax.numerics.lanes import any_lane
from bojax.numerics.linalg import matmul, solve


class _PolicyData(eqx.Module):
    """Quantities of every transition that are fixed once the policy is.

    Attributes:
        chosen: Index of a' = pi(s') among the candidates.
        factor: `EMUQModel.u_factor` at (s', a').
        bonus: Exploration reward.
    """

    chosen: Int[Array, "C"]
    factor: Float[Array, "C"]
    bonus: Float[Array, "C"]


class Refit(eqx.Module):
    """The fit of the means of Q and U to all transitions.

    Attributes:
        model: Model of Q and U.
        tolerance: Change of the weights (Euclidean norm) at which sweeps stop.
        is_direct: Whether the equations are solved instead of swept.
        max_sweeps: Largest number of sweeps, or of policies whose equations are solved.
        block: Number of transitions whose features are in memory at a time.
    """

    model: EMUQModel
    tolerance: Float[Array, ""]
    is_direct: bool = eqx.field(static=True)
    max_sweeps: int = eqx.field(static=True)
    block: int = eqx.field(static=True)

    def __call__(
        self, key: Key[Array, ""], state: EMUQState, kappa: Float[Array, ""], is_active: Bool[Array, ""]
    ) -> Float[Array, "M 2"]:
        """The fitted means of Q and U; unchanged if not active.

        Lines 14 and 15 fit Q, with a' chosen anew by Q + kappa U in every sweep or solution. Lines 16 and 17
        compute the exploration rewards (5.12) and fit U, with a' chosen once.
        """
        key_q, key_policy = jax.random.split(key)
        q = self._fit_q(key_q, state, kappa, is_active)
        mean = state.posterior.mean.at[:, Q].set(q)
        candidates, samples = self.model.actions(key_policy, state)
        policy = self._evaluate_policy(state, mean, kappa, candidates, samples)
        return mean.at[:, U].set(self._fit_u(state, policy, candidates, mean[:, U], is_active))

    def _fit_q(
        self, key: Key[Array, ""], state: EMUQState, kappa: Float[Array, ""], is_active: Bool[Array, ""]
    ) -> Float[Array, "M"]:
        model, posterior, memory = self.model, state.posterior, state.memory
        gain = model.noise_precision * posterior.base
        u = posterior.mean[:, U]

        def update(number, q):
            candidates, _ = model.actions(jax.random.fold_in(key, number), state)
            ys = jax.vmap(state.features.action)(candidates)
            next_values = self._next_values(state, ys, jnp.stack([q, u], axis=1))

            def parts(rows: Memory, is_valid):
                """Index of a', Q(s', a') and its factor in the TD target."""
                values, factor = next_values(rows)
                chosen = _choose(values, factor, kappa)
                value = jnp.take_along_axis(values[:, :, Q], chosen[:, None], axis=1)[:, 0]
                return chosen, value, model.q_discount(rows.terminated, is_valid)

            def sweep(total, rows, index, is_valid):
                del index
                _, value, discount = parts(rows, is_valid)
                target = jnp.where(is_valid, rows.rewards, 0.0) + discount * value
                return total + matmul(target, _features(state, rows))

            def equations(total, rows, index, is_valid):
                del index
                chosen, _, discount = parts(rows, is_valid)
                reward = jnp.where(is_valid, rows.rewards, 0.0)
                return _accumulate(state, total, rows, ys[chosen], discount, reward)

            if self.is_direct:
                return _solution(gain, memory.fold(equations, _zeros(q), self.block))
            return matmul(gain, memory.fold(sweep, jnp.zeros_like(q), self.block))

        return self._until_converged(update, posterior.mean[:, Q], is_active)

    def _evaluate_policy(
        self,
        state: EMUQState,
        mean: Float[Array, "M 2"],
        kappa: Float[Array, ""],
        candidates: Action,
        samples: Action,
    ) -> _PolicyData:
        """Choose a' at every next state and compute the exploration rewards there."""
        model, features, memory = self.model, state.features, state.memory
        capacity, dtype = len(memory.rewards), mean.dtype
        next_values = self._next_values(state, jax.vmap(features.action)(candidates), mean)
        forms = jax.vmap(lambda a: features.split_both(state.posterior.base, features.action(a)))(samples)
        if not model.mixes_transitions:  # the mean over the samples can be taken first
            forms = jnp.mean(forms, axis=0)[None]

        def visit(arrays, rows, index, is_valid):
            del is_valid
            values, factor = next_values(rows)
            best = _choose(values, factor, kappa).astype(jnp.int32)
            new = (
                best,
                jnp.take_along_axis(factor, best[:, None], axis=1)[:, 0],
                _quadratic_forms(jax.vmap(features.state)(rows.next_observations), forms),
            )
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(array, block, index[0], 0)
                for array, block in zip(arrays, new, strict=True)
            )

        start = (
            jnp.zeros((capacity,), jnp.int32),
            jnp.ones((capacity,), dtype),
            jnp.zeros((capacity, len(forms)), dtype),
        )
        chosen, factor, variances = memory.fold(visit, start, self.block)
        bonus = model.exploration_reward(model.mean_variances(variances, memory.count))
        return _PolicyData(chosen, factor, bonus)

    def _fit_u(
        self,
        state: EMUQState,
        policy: _PolicyData,
        candidates: Action,
        u: Float[Array, "M"],
        is_active: Bool[Array, ""],
    ) -> Float[Array, "M"]:
        model, posterior, memory = self.model, state.posterior, state.memory
        ys = jax.vmap(state.features.action)(candidates)
        gain = model.noise_precision * posterior.base

        def equations(total, rows, index, is_valid):
            constant, discount = model.u_terms(policy.bonus[index], policy.factor[index], rows.terminated)
            zero = jnp.zeros((), u.dtype)
            constant, discount = jnp.where(is_valid, constant, zero), jnp.where(is_valid, discount, zero)
            return _accumulate(state, total, rows, ys[policy.chosen[index]], discount, constant)

        matrix, vector = memory.fold(equations, _zeros(u), self.block)
        if self.is_direct:
            return jnp.where(is_active, _solution(gain, (matrix, vector)), u)
        # With a' fixed, a sweep is an affine map of the weights: one pass over the transitions is enough.
        matrix, vector = matmul(gain, matrix), matmul(gain, vector)
        return self._until_converged(lambda _, u: vector + matmul(matrix, u), u, is_active)

    def _until_converged(
        self,
        update: Callable[[Int[Array, ""], Float[Array, "M"]], Float[Array, "M"]],
        start: Float[Array, "M"],
        is_active: Bool[Array, ""],
    ) -> Float[Array, "M"]:
        """Repeat `update(number, weights)` until the weights of every lane have converged."""

        def step(loop):
            number, weights, going = loop
            after = update(number, weights)
            number = number + 1
            is_far = jnp.linalg.norm(after - weights) > self.tolerance
            going_on = going & is_far & (number < self.max_sweeps)
            return number, jnp.where(going, after, weights), going_on

        loop = jnp.zeros((), jnp.int32), start, is_active
        return jax.lax.while_loop(lambda loop: any_lane(loop[2]), step, loop)[1]

    def _next_values(self, state: EMUQState, ys: Float[Array, "J R"], mean: Float[Array, "M 2"]):
        """A function of some transitions: Q and U of every candidate at s', and the factors of U."""
        model, features = self.model, state.features
        weights = jax.vmap(lambda y: jax.vmap(features.split, (1, None), 1)(mean, y), out_axes=1)(ys)
        forms = None
        if model.optimistic_u:
            forms = jax.vmap(lambda y: features.split_both(state.posterior.base, y))(ys)

        def next_values(rows: Memory) -> tuple[Float[Array, "B J 2"], Float[Array, "B J"]]:
            x = jax.vmap(features.state)(rows.next_observations)
            values = matmul(x, weights.reshape(weights.shape[0], -1)).reshape(len(x), -1, 2)
            if forms is None:
                return values, jnp.ones(values.shape[:2], values.dtype)
            return values, model.u_factor(_quadratic_forms(x, forms))

        return next_values


def _choose(
    values: Float[Array, "B J 2"], factor: Float[Array, "B J"], kappa: Float[Array, ""]
) -> Int[Array, "B"]:
    """Index of a' = argmax Q + kappa U."""
    values = values.at[:, :, U].multiply(factor)
    return jnp.argmax(values[:, :, Q] + kappa * values[:, :, U], axis=1)


def _quadratic_forms(x: Float[Array, "B P"], forms: Float[Array, "J P P"]) -> Float[Array, "B J"]:
    """The quadratic form x'F x of every row x and every matrix F."""
    return jax.vmap(lambda form: jnp.sum(matmul(x, form) * x, axis=1), out_axes=1)(forms)


def _features(state: EMUQState, rows: Memory) -> Float[Array, "B M"]:
    return jax.vmap(state.features)(rows.observations, rows.actions)


def _zeros(weights: Float[Array, "M"]) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
    return jnp.zeros((len(weights), len(weights)), weights.dtype), jnp.zeros_like(weights)


def _accumulate(
    state: EMUQState,
    total: tuple[Float[Array, "M M"], Float[Array, "M"]],
    rows: Memory,
    y: Float[Array, "B R"],
    discount: Float[Array, "B"],
    reward: Float[Array, "B"],
) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
    """Add Phi'diag(discount) Phi_next and Phi'reward of some transitions; y are the features of their a'."""
    matrix, vector = total
    x = jax.vmap(state.features.state)(rows.next_observations)
    phi, phi_next = _features(state, rows), jax.vmap(state.features.join)(x, y)
    return matrix + matmul(phi.T, discount[:, None] * phi_next), vector + matmul(reward, phi)


def _solution(
    gain: Float[Array, "M M"], total: tuple[Float[Array, "M M"], Float[Array, "M"]]
) -> Float[Array, "M"]:
    """The weights m with (I - gain matrix) m = gain vector."""
    matrix, vector = total
    identity = jnp.eye(len(vector), dtype=vector.dtype)
    return solve(identity - matmul(gain, matrix), matmul(gain, vector)[:, None])[:, 0]
