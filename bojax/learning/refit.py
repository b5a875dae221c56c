"""The fit of Q and U to all transitions at the end of an episode of EMU-Q (Algorithm 6, lines 14 to 17).

The covariance S stays the same; the TD targets are those of the current policy pi. The means are fitted
either by sweeps, m <- beta S Phi'(r + gamma Phi_next m), or by solving the equations that the sweeps converge
to, (I - beta gamma S Phi'Phi_next) m = beta S Phi'r.

The matrices of two policies in succession differ little. The inverse for one policy is therefore kept as the
preconditioner of the equations of the following policies, which take a few products with the features. If
these do not converge, every further policy gets an inverse of its own.
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
from bojax.numerics.linalg import gcr, inverse_matrix, matmul, matmul_on_tensor_cores

NUM_STORED = 2048
"""Largest number of transitions whose features are stored during a refit: the first ones of a run.

They take 8 MB a run for 500 features in float32. The features of later transitions are recomputed, a block at
a time, whenever they are needed.
"""

MOST_ON_CPU = 64
"""Largest block on a CPU.

The last block is padded. Blocks of 512, which need fewer launches on a GPU, take 2.8 times as long for 28
transitions on a CPU, and as long for 2,500.
"""


class _Rows(eqx.Module):
    """A block of transitions and their features.

    Attributes:
        memory: The transitions.
        index: Their positions.
        is_valid: Which of them to count.
        phi: phi(s, a).
        x: x(s').
    """

    memory: Memory
    index: Int[Array, "B"]
    is_valid: Bool[Array, "B"]
    phi: Float[Array, "B M"]
    x: Float[Array, "B P"]


class _Transitions(eqx.Module):
    """All transitions of a run and their features, stored or recomputed.

    Attributes:
        state: State of the learner.
        phi: phi(s, a) of the first transitions.
        x: x(s') of the first transitions.
        block: Number of transitions in a block.
    """

    state: EMUQState
    phi: Float[Array, "T M"]
    x: Float[Array, "T P"]
    block: int = eqx.field(static=True)

    @classmethod
    def of(cls, state: EMUQState, block: int) -> "_Transitions":
        """The transitions in memory, in blocks of at most `block`."""
        if jax.default_backend() == "cpu":
            block = min(block, MOST_ON_CPU)
        number = min(NUM_STORED, len(state.memory.rewards))

        def visit(arrays, rows, index, is_valid):
            del is_valid
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(array, new, index[0], 0)
                for array, new in zip(arrays, _features(state, rows), strict=True)
            )

        shapes = jax.eval_shape(_features, state, state.memory)
        start = tuple(jnp.zeros((number, *shape.shape[1:]), shape.dtype) for shape in shapes)
        phi, x = state.memory.fold(visit, start, block, end=number)
        return cls(state, phi, x, block)

    def fold(self, function, start):
        """Fold a function `(carry, rows) -> carry` over blocks of transitions, where `rows` is a `_Rows`."""

        def stored(carry, memory, index, is_valid):
            phi, x = (jax.lax.dynamic_slice_in_dim(a, index[0], len(index)) for a in (self.phi, self.x))
            return function(carry, _Rows(memory, index, is_valid, phi, x))

        def recomputed(carry, memory, index, is_valid):
            return function(carry, _Rows(memory, index, is_valid, *_features(self.state, memory)))

        memory, number = self.state.memory, len(self.phi)
        carry = memory.fold(stored, start, self.block, end=number)
        return memory.fold(recomputed, carry, self.block, first=number)


class _Equations(eqx.Module):
    """The equations m = beta S Phi'(constant + discount Phi_next m) of a given policy.

    Attributes:
        transitions: The transitions.
        gain: beta S.
        ys: Features y(a') of the candidates.
        chosen: Index of a' = pi(s') among the candidates.
        terms: A function of some rows: their constants and discounts, 0 for rows that are not valid.
        targets: Phi'(constant + discount Phi_next m) of the weights m that the policy was made for.
    """

    transitions: _Transitions
    gain: Float[Array, "M M"]
    ys: Float[Array, "J R"]
    chosen: Int[Array, "C"]
    terms: Callable[[_Rows], tuple[Float[Array, "B"], Float[Array, "B"]]]
    targets: Float[Array, "M"]

    def image(self, weights: Float[Array, "M"]) -> Float[Array, "M"]:
        """The right-hand side without the constants."""
        # A product with phi(s', a') is one with x(s') alone.
        split = jax.vmap(self.transitions.state.features.split, (None, 0))(weights, self.ys)

        def visit(total, rows):
            _, discount = self.terms(rows)
            value = jnp.sum(rows.x * split[self.chosen[rows.index]], axis=1)
            return total + matmul(discount * value, rows.phi)

        return matmul(self.gain, self.transitions.fold(visit, jnp.zeros_like(weights)))

    def matrix_and_constant(self) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
        """The right-hand side as a function of the weights: F and c of beta S (F m + c)."""

        def visit(total, rows):
            matrix, vector = total
            constant, discount = self.terms(rows)
            phi_next = jax.vmap(self.transitions.state.features.join)(
                rows.x, self.ys[self.chosen[rows.index]]
            )
            phi_next = discount[:, None] * phi_next
            return matrix + matmul_on_tensor_cores(rows.phi.T, phi_next), vector + matmul(constant, rows.phi)

        start = jnp.zeros_like(self.gain), jnp.zeros_like(self.gain[0])
        return self.transitions.fold(visit, start)

    def inverse(self) -> Float[Array, "M M"]:
        """The inverse of I - beta S F."""
        identity = jnp.eye(len(self.gain), dtype=self.gain.dtype)
        matrix, _ = self.matrix_and_constant()
        return inverse_matrix(identity - matmul_on_tensor_cores(self.gain, matrix))

    def solution(
        self, inverse: Float[Array, "M M"], start: Float[Array, "M"], is_active: Bool[Array, ""]
    ) -> tuple[Float[Array, "M"], Bool[Array, ""]]:
        """The weights that solve the equations, given an approximation of `inverse()`; see `gcr`.

        They start from the weights m of `targets`.
        """
        residual = matmul(self.gain, self.targets) - start
        return gcr(lambda m: m - self.image(m), inverse, start, residual, is_active)


class _Policy(eqx.Module):
    """The policy pi = argmax Q + kappa U over candidates that are drawn once.

    Attributes:
        model: Model of Q and U.
        kappa: Weight of U.
        weights: Weights of x(s') in Q and U of every candidate.
        ys: Features y(a) of the candidates.
        forms: Quadratic forms of x(s') in the variance of every candidate; None if U needs no variance.
    """

    model: EMUQModel
    kappa: Float[Array, ""]
    weights: Float[Array, "P J 2"]
    ys: Float[Array, "J R"]
    forms: Float[Array, "J P P"] | None

    @classmethod
    def of(
        cls,
        model: EMUQModel,
        state: EMUQState,
        candidates: Action,
        mean: Float[Array, "M 2"],
        kappa: Float[Array, ""],
    ) -> "_Policy":
        """The policy for the means of Q and U."""
        features = state.features
        ys = jax.vmap(features.action)(candidates)
        weights = jax.vmap(lambda y: jax.vmap(features.split, (1, None), 1)(mean, y), out_axes=1)(ys)
        forms = None
        if model.optimistic_u:
            forms = jax.vmap(lambda y: features.mean_form(state.posterior.base, y[None]))(ys)
        return cls(model, kappa, weights, ys, forms)

    def __call__(
        self, x: Float[Array, "B P"]
    ) -> tuple[Int[Array, "B"], Float[Array, "B 2"], Float[Array, "B"]]:
        """Index of the chosen candidate at every x(s'), its phi'm_Q and phi'm_U, and its factor of U."""
        values = matmul_on_tensor_cores(x, self.weights.reshape(self.weights.shape[0], -1))
        values = values.reshape(len(x), -1, 2)
        factors = jnp.ones(values.shape[:2], values.dtype)
        if self.forms is not None:
            factors = self.model.u_factor(_quadratic_forms(x, self.forms))
        scores = values[:, :, Q] + self.kappa * (values[:, :, U] * factors)
        chosen = jnp.argmax(scores, axis=1).astype(jnp.int32)
        value = jnp.take_along_axis(values, chosen[:, None, None], axis=1)[:, 0]
        return chosen, value, jnp.take_along_axis(factors, chosen[:, None], axis=1)[:, 0]


class Refit(eqx.Module):
    """The fit of the means of Q and U to all transitions.

    Attributes:
        model: Model of Q and U.
        tolerance: Change of the weights (Euclidean norm) at which sweeps stop.
        is_direct: Whether the equations are solved instead of swept.
        max_sweeps: Largest number of sweeps, or of policies whose equations are solved.
        block: Number of transitions that are visited at a time.
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
        key_q, key_u = jax.random.split(key)
        transitions, mean = _Transitions.of(state, self.block), state.posterior.mean
        gain = self.model.noise_precision * state.posterior.base

        def policy(key: Key[Array, ""], mean: Float[Array, "M 2"]) -> tuple[_Policy, Action]:
            candidates, samples = self.model.actions(key, state)
            return _Policy.of(self.model, state, candidates, mean, kappa), samples

        def policy_of_q(number: Int[Array, ""], q: Float[Array, "M"]) -> _Policy:
            return policy(jax.random.fold_in(key_q, number), mean.at[:, Q].set(q))[0]

        if not self.is_direct:

            def sweep(number, q):
                return matmul(gain, self._q_equations(transitions, gain, policy_of_q(number, q)).targets)

            mean = mean.at[:, Q].set(self._until_converged(sweep, mean[:, Q], is_active))
            # With a' fixed, a sweep is an affine map of the weights: one pass over the transitions is enough.
            # Two products with vectors in every sweep take less time than the product of both matrices.
            equations = self._u_equations(transitions, gain, *policy(key_u, mean))
            matrix, constant = equations.matrix_and_constant()

            def sweep_u(_, u):
                return matmul(gain, constant + matmul(matrix, u))

            return mean.at[:, U].set(self._until_converged(sweep_u, mean[:, U], is_active))

        def q_equations(number: Int[Array, ""], q: Float[Array, "M"]) -> _Equations:
            return self._q_equations(transitions, gain, policy_of_q(number, q))

        inverse, is_similar = jnp.zeros_like(gain), jnp.zeros((), bool)
        q, inverse = self._solve(q_equations, mean[:, Q], inverse, is_similar, is_active, self.max_sweeps)
        mean = mean.at[:, Q].set(q)
        equations = self._u_equations(transitions, gain, *policy(key_u, mean))
        u, _ = self._solve(lambda number, u: equations, mean[:, U], inverse, is_active, is_active, 1)
        return mean.at[:, U].set(u)

    def _q_equations(
        self, transitions: _Transitions, gain: Float[Array, "M M"], policy: _Policy
    ) -> _Equations:
        def visit(arrays, rows):
            chosen, targets = arrays
            new, value, _ = policy(rows.x)
            constant, discount = self._q_terms(rows)
            chosen = jax.lax.dynamic_update_slice_in_dim(chosen, new, rows.index[0], 0)
            return chosen, targets + matmul(constant + discount * value[:, Q], rows.phi)

        capacity = len(transitions.state.memory.rewards)
        start = jnp.zeros((capacity,), jnp.int32), jnp.zeros_like(gain[0])
        chosen, targets = transitions.fold(visit, start)
        return _Equations(transitions, gain, policy.ys, chosen, self._q_terms, targets)

    def _q_terms(self, rows: _Rows) -> tuple[Float[Array, "B"], Float[Array, "B"]]:
        reward = jnp.where(rows.is_valid, rows.memory.rewards, 0.0)
        return reward, self.model.q_discount(rows.memory.terminated, rows.is_valid)

    def _u_equations(
        self,
        transitions: _Transitions,
        gain: Float[Array, "M M"],
        policy: _Policy,
        samples: Action,
    ) -> _Equations:
        """The equations of U, with the exploration rewards (5.12) for the actions of `samples`."""
        model, state = self.model, transitions.state
        features, memory, dtype = state.features, state.memory, gain.dtype
        samples = jax.vmap(features.action)(samples)
        # The mean over the samples can be taken first, unless it is the published code's.
        groups = samples[:, None] if model.mixes_transitions else samples[None]
        forms = jax.vmap(lambda ys: features.mean_form(state.posterior.base, ys))(groups)

        def visit(arrays, rows):
            chosen, value, factor = policy(rows.x)
            new = chosen, value[:, U], factor, _quadratic_forms(rows.x, forms)
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(array, block, rows.index[0], 0)
                for array, block in zip(arrays, new, strict=True)
            )

        capacity = len(memory.rewards)
        start = (
            jnp.zeros((capacity,), jnp.int32),
            jnp.zeros((capacity,), dtype),
            jnp.ones((capacity,), dtype),
            jnp.zeros((capacity, len(forms)), dtype),
        )
        chosen, value, factor, variances = transitions.fold(visit, start)
        bonus = model.exploration_reward(model.mean_variances(variances, memory.count))

        def terms(rows: _Rows):
            index, zero = rows.index, jnp.zeros((), dtype)
            constant, discount = model.u_terms(bonus[index], factor[index], rows.memory.terminated)
            return jnp.where(rows.is_valid, constant, zero), jnp.where(rows.is_valid, discount, zero)

        def add(targets, rows):
            constant, discount = terms(rows)
            return targets + matmul(constant + discount * value[rows.index], rows.phi)

        targets = transitions.fold(add, jnp.zeros_like(gain[0]))
        return _Equations(transitions, gain, policy.ys, chosen, terms, targets)

    def _solve(
        self,
        policy: Callable[[Int[Array, ""], Float[Array, "M"]], _Equations],
        weights: Float[Array, "M"],
        inverse: Float[Array, "M M"],
        is_similar: Bool[Array, ""],
        is_active: Bool[Array, ""],
        most: int,
    ) -> tuple[Float[Array, "M"], Float[Array, "M M"]]:
        """Solve the equations of `policy(number, weights)` until the weights of every lane have converged.

        Args:
            policy: The equations for the policy of the given weights.
            weights: Weights to start from.
            inverse: Inverse of the matrix of similar equations.
            is_similar: Whether there is such an inverse.
            is_active: Whether the weights may change.
            most: Largest number of policies.

        Returns:
            The weights, and the last inverse matrix.
        """

        def step(loop):
            number, weights, inverse, is_similar, going = loop
            equations = policy(number, weights)
            inverse = jax.lax.cond(
                any_lane(going & ~is_similar),
                lambda: jnp.where(is_similar, inverse, equations.inverse()),
                lambda: inverse,
            )
            after, is_solved = equations.solution(inverse, weights, going)
            # A solution that does not converge is discarded. The same policy and all later ones of this lane
            # then get their own inverse: to try an earlier one every time would cost more than it saves.
            is_taken = going & (is_solved | ~is_similar)
            is_far = jnp.linalg.norm(after - weights) > self.tolerance
            number = number + is_taken.astype(number.dtype)
            going_on = going & (~is_taken | (is_far & (number < most)))
            is_similar = (is_similar & is_solved) | (is_taken & (number == 1)) | ~going
            return number, jnp.where(is_taken, after, weights), inverse, is_similar, going_on

        start = jnp.zeros((), jnp.int32), weights, inverse, is_similar, is_active
        _, weights, inverse, _, _ = jax.lax.while_loop(lambda loop: any_lane(loop[-1]), step, start)
        return weights, inverse

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


def _quadratic_forms(x: Float[Array, "B P"], forms: Float[Array, "J P P"]) -> Float[Array, "B J"]:
    """The quadratic form x'F x of every row x and every matrix F."""
    return jax.vmap(lambda form: jnp.sum(matmul_on_tensor_cores(x, form) * x, axis=1), out_axes=1)(forms)


def _features(state: EMUQState, memory: Memory) -> tuple[Float[Array, "B M"], Float[Array, "B P"]]:
    """phi(s, a) and x(s') of some transitions."""
    phi = jax.vmap(state.features)(memory.observations, memory.actions)
    return phi, jax.vmap(state.features.state)(memory.next_observations)
