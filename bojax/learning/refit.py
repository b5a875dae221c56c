"""The fit of Q and U to all transitions at the end of an episode of EMU-Q (Algorithm 6, lines 14 to 17).

The covariance S stays the same; the TD targets are those of the current policy pi. The means are fitted
either by sweeps, m <- beta S Phi'(r + gamma Phi_next m), or by solving the equations that the sweeps converge
to, (I - beta gamma S Phi'Phi_next) m = beta S Phi'r.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Shaped, UInt32

from bojax.envs.base import Action
from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.features import StateActionFeatures
from bojax.learning.memory import Memory, T
from bojax.numerics.lanes import any_lane, batched_together
from bojax.numerics.linalg import gcr, inverse_matrix, matmul, matmul_on_tensor_cores, row_sums
from bojax.numerics.stragglers import while_going

# 8 MB a run for 500 features in float32. On a CPU, which stores the features of one run of a batch at a time,
# refits of the reacher with 2,600 to 4,600 transitions take two thirds of their time with 2,048. With 8,192,
# filling the arrays with zeros takes longer than a short refit.
NUM_STORED, NUM_STORED_ON_CPU = 2048, 4096
"""Largest number of transitions whose features are stored during a refit: the first ones of a run."""

# The last block is padded. Blocks of 512, which need fewer launches on a GPU, take 2.8 times as long for 28
# transitions on a CPU, and as long for 2,500.
MOST_ON_CPU = 64  # largest block on a CPU


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

    def of(self, array: Shaped[Array, "C *N"]) -> Shaped[Array, "B *N"]:
        """The entries of these transitions."""
        return jax.lax.dynamic_slice_in_dim(array, self.index[0], len(self.index))

    def valid(self, entries: Shaped[Array, "B *N"]) -> Shaped[Array, "B *N"]:
        """The entries of transitions that count, and 0 for the others."""
        is_valid = self.is_valid.reshape(-1, *[1] * (entries.ndim - 1))
        return jnp.where(is_valid, entries, jnp.zeros((), entries.dtype))

    def put(self, arrays: T, entries: T) -> T:
        """Arrays of one entry for each transition, with those of these transitions replaced."""
        return jax.tree.map(
            lambda array, new: jax.lax.dynamic_update_slice_in_dim(array, new, self.index[0], 0),
            arrays,
            entries,
        )


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
        most = NUM_STORED_ON_CPU if jax.default_backend() == "cpu" else NUM_STORED
        number = min(most, len(state.memory.rewards))

        def visit(arrays, rows, index, is_valid):
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

        # The first transitions are read from the arrays, later ones are computed again in every pass: stored,
        # they would take gigabytes in a batch.
        memory, number = self.state.memory, len(self.phi)
        carry = memory.fold(stored, start, self.block, end=number)
        return memory.fold(recomputed, carry, self.block, first=number)


class _Candidates(eqx.Module):
    """Actions over which a policy maximises Q + kappa U, and what does not depend on the weights.

    Attributes:
        model: Model of Q and U.
        features: Feature map phi.
        kappa: Weight of U.
        ys: Features y(a) of the candidates.
        forms: Quadratic forms of x(s') in the variance of every candidate; None if U needs no variance.
    """

    model: EMUQModel
    features: StateActionFeatures
    kappa: Float[Array, ""]
    ys: Float[Array, "J R"]
    forms: Float[Array, "J P P"] | None

    @classmethod
    def of(
        cls, model: EMUQModel, state: EMUQState, actions: Action, kappa: Float[Array, ""]
    ) -> "_Candidates":
        features, forms = state.features, None
        ys = jax.vmap(features.action)(actions)
        if model.optimistic_u:
            forms = jax.vmap(lambda y: features.mean_form(state.posterior.base, y[None]))(ys)
        return cls(model, features, kappa, ys, forms)

    def split(self, weights: Float[Array, "M"]) -> Float[Array, "J P"]:
        """Weights of x(s') in the values of every candidate."""
        return jax.vmap(self.features.split, (None, 0))(weights, self.ys)

    def policy(
        self, mean: Float[Array, "M 2"]
    ) -> Callable[[Float[Array, "B P"]], tuple[Int[Array, "B"], Float[Array, "B 2"], Float[Array, "B"]]]:
        """The policy pi = argmax Q + kappa U, as a function of x(s').

        It gives the index of the chosen candidate, its phi'm_Q and phi'm_U, and its factor of U.
        """
        # Features are bilinear: phi(s', a)'m = x(s')'split(m, y(a)). One product of x with a matrix gives Q
        # and U of all candidates, and phi(s', a) is computed for none of them.
        weights = jax.vmap(self.split, 1, 2)(mean)
        weights = jnp.moveaxis(weights, 0, 1).reshape(weights.shape[1], -1)

        def choose(x):
            values = matmul_on_tensor_cores(x, weights).reshape(len(x), -1, 2)
            factors = jnp.ones(values.shape[:2], values.dtype)
            if self.forms is not None:
                factors = self.model.u_factor(_quadratic_forms(x, self.forms))
            scores = values[:, :, Q] + self.kappa * (values[:, :, U] * factors)
            chosen = jnp.argmax(scores, axis=1).astype(jnp.int32)
            value = jnp.take_along_axis(values, chosen[:, None, None], axis=1)[:, 0]
            return chosen, value, jnp.take_along_axis(factors, chosen[:, None], axis=1)[:, 0]

        return choose


class _Policy(eqx.Module):
    """The policy of some means, and what the equations of Q and U need of it.

    Attributes:
        transitions: The transitions.
        gain: beta S.
        candidates: The actions among which the policy chooses.
        chosen: Index of a' = pi(s') among them.
        signature: A hash of all choices.
        constants: Constant terms of every target, of Q and of U.
        discounts: Factors of phi(s', a')'m in every target, of Q and of U.
        targets: Phi'(constant + discount Phi_next m), of Q and of U, where m are the given means.
    """

    transitions: _Transitions
    gain: Float[Array, "M M"]
    candidates: _Candidates
    chosen: Int[Array, "C"]
    signature: UInt32[Array, "2"]
    constants: Float[Array, "C 2"]
    discounts: Float[Array, "C 2"]
    targets: Float[Array, "2 M"]

    @classmethod
    def of(
        cls,
        transitions: _Transitions,
        gain: Float[Array, "M M"],
        candidates: _Candidates,
        bonus: Float[Array, "C"],
        mean: Float[Array, "M 2"],
    ) -> "_Policy":
        """The policy of the given means; `bonus` is the exploration reward of every transition."""
        model, choose = candidates.model, candidates.policy(mean)

        def visit(carry, rows):
            arrays, signature, targets = carry
            chosen, values, factor = choose(rows.x)
            terminated = rows.memory.terminated
            q_terms = rows.memory.rewards, model.q_discount(terminated)
            u_terms = model.u_terms(rows.of(bonus), factor, terminated)
            constants, discounts = (jnp.stack(pair, axis=1) for pair in zip(q_terms, u_terms, strict=True))
            # The hash and the right-hand side of the equations come out of the same pass over the
            # transitions.
            target = rows.valid(constants + discounts * values)
            salted = _salts(rows.index) * chosen.astype(jnp.uint32)[:, None]
            signature = signature + jnp.sum(rows.valid(salted), axis=0, dtype=jnp.uint32)
            arrays = rows.put(arrays, (chosen, constants, discounts))
            return arrays, signature, targets + matmul(target.T, rows.phi)

        zeros = jnp.zeros((len(bonus), 2), bonus.dtype)
        start = jnp.zeros_like(bonus, jnp.int32), zeros, zeros
        none = jnp.zeros(2, jnp.uint32), jnp.zeros_like(mean.T)
        (chosen, constants, discounts), signature, targets = transitions.fold(visit, (start, *none))
        return cls(transitions, gain, candidates, chosen, signature, constants, discounts, targets)

    def equations(self, is_u: Bool[Array, ""] | bool) -> "_Equations":
        """The equations of U if `is_u`, or else of Q."""
        # Selected rather than branched on: lanes of a batch are at Q and at U at the same time.
        of_both = self.constants.T, self.discounts.T, self.targets
        terms = (jnp.where(is_u, both[U], both[Q]) for both in of_both)
        return _Equations(self.transitions, self.gain, self.candidates, self.chosen, *terms)


class _Equations(eqx.Module):
    """The equations m = beta S Phi'(constant + discount Phi_next m) of Q or of U, for a given policy.

    The fields are as in `_Policy`, for Q or U alone.
    """

    transitions: _Transitions
    gain: Float[Array, "M M"]
    candidates: _Candidates
    chosen: Int[Array, "C"]
    constant: Float[Array, "C"]
    discount: Float[Array, "C"]
    targets: Float[Array, "M"]

    def image(self, weights: Float[Array, "M"]) -> Float[Array, "M"]:
        """The right-hand side without the constants."""
        # A product with phi(s', a') is one with x(s') alone, by the bilinearity of the features.
        split = self.candidates.split(weights)

        def visit(total, rows):
            value = row_sums(rows.x * split[rows.of(self.chosen)])
            return total + matmul(rows.valid(rows.of(self.discount)) * value, rows.phi)

        return matmul(self.gain, self.transitions.fold(visit, jnp.zeros_like(weights)))

    def clipped_sweep(self, weights: Float[Array, "M"]) -> Float[Array, "M"]:
        """The right-hand side, with U of the next states clipped."""
        split = self.candidates.split(weights)

        def visit(total, rows):
            value = self.candidates.model.clipped_u(row_sums(rows.x * split[rows.of(self.chosen)]))
            target = rows.of(self.constant) + rows.of(self.discount) * value
            return total + matmul(rows.valid(target), rows.phi)

        return matmul(self.gain, self.transitions.fold(visit, jnp.zeros_like(weights)))

    def matrix_and_constant(self) -> tuple[Float[Array, "M M"], Float[Array, "M"]]:
        """The right-hand side as a function of the weights: F and c of beta S (F m + c)."""
        join = jax.vmap(self.candidates.features.join)

        def visit(total, rows):
            matrix, vector = total
            phi_next = join(rows.x, self.candidates.ys[rows.of(self.chosen)])
            phi_next = rows.valid(rows.of(self.discount))[:, None] * phi_next
            matrix = matrix + matmul_on_tensor_cores(rows.phi.T, phi_next)
            return matrix, vector + matmul(rows.valid(rows.of(self.constant)), rows.phi)

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
        # `targets` was computed with the policy at its own weights, so that the first residual costs no pass.
        residual = matmul(self.gain, self.targets) - start
        return gcr(lambda m: m - self.image(m), inverse, start, residual, is_active)


class Refit(eqx.Module):
    """The fit of the means of Q and U to all transitions; the fields are settings of `EMUQ`."""

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

        The thesis does not say over which actions the policy maximises: every sweep draws its own candidates,
        as the published code does; a direct solution, which that code lacks, draws them once.
        """
        key_q, key_u = jax.random.split(key)
        transitions = _Transitions.of(state, _largest_block(self.block))
        mean = state.posterior.mean
        gain = self.model.noise_precision * state.posterior.base
        drawn, samples = self.model.actions(key_u, state)
        bonus = self._exploration_rewards(state, samples)

        def policy(candidates, mean):
            return _Policy.of(transitions, gain, candidates, bonus, mean)

        candidates = _Candidates.of(self.model, state, drawn, kappa)
        if self.is_direct:
            # With one set of candidates there are finitely many policies, which usually settle after a few.
            solution = self._solve(partial(policy, candidates), mean, is_active)
            if not self.model.clips_u:
                return solution
            # The equations with clipped values are not linear. Sweeps of bounded targets follow the solution
            # of the linear ones; they end at once where it leaves no bound.
            equations = policy(candidates, solution.at[:, U].set(mean[:, U])).equations(True)
            return self._swept_u(lambda _, u: equations.clipped_sweep(u), solution, is_active)

        # Lines 14-15: m_Q <- beta S Phi'(r + gamma Phi_next m_Q), with a' greedy for the current m_Q and m_U.
        def sweep(number, q):
            actions, _ = self.model.actions(jax.random.fold_in(key_q, number), state)
            anew = _Candidates.of(self.model, state, actions, kappa)
            return matmul(gain, policy(anew, mean.at[:, Q].set(q)).targets[Q])

        mean = mean.at[:, Q].set(self._until_converged(sweep, mean[:, Q], is_active))
        # Lines 16-17. With a' fixed, a sweep is an affine map of the weights: one pass over the transitions
        # is enough. Two products with vectors in every sweep take less time than the product of both
        # matrices.
        equations = policy(candidates, mean).equations(True)
        if self.model.clips_u:
            return self._swept_u(lambda _, u: equations.clipped_sweep(u), mean, is_active)
        matrix, constant = equations.matrix_and_constant()
        return self._swept_u(lambda _, u: matmul(gain, constant + matmul(matrix, u)), mean, is_active)

    def _exploration_rewards(self, state: EMUQState, samples: Action) -> Float[Array, "C"]:
        """The exploration reward (5.12) of every transition, for the actions of `samples`."""
        model, features, memory = self.model, state.features, state.memory
        ys = jax.vmap(features.action)(samples)
        # The mean over the samples can be taken first, unless it is the published code's.
        groups = ys[:, None] if model.mixes_transitions else ys[None]
        forms = jax.vmap(lambda ys: features.mean_form(state.posterior.base, ys))(groups)

        # Computed once a refit, so x(s') is computed again here: reading the stored part would put a second
        # loop into the program.
        def visit(variances, rows, index, _):
            x = jax.vmap(features.state)(rows.next_observations)
            return jax.lax.dynamic_update_slice_in_dim(variances, _quadratic_forms(x, forms), index[0], 0)

        start = jnp.zeros((len(memory.rewards), len(forms)), forms.dtype)
        variances = memory.fold(visit, start, _largest_block(self.block))
        return model.exploration_reward(model.mean_variances(variances, memory.count))

    def _solve(
        self,
        policy_of: Callable[[Float[Array, "M 2"]], _Policy],
        mean: Float[Array, "M 2"],
        is_active: Bool[Array, ""],
    ) -> Float[Array, "M 2"]:
        """Solve the equations of Q for one policy after the other, and then those of U for the last one."""

        # Policy iteration: solve the equations of a policy, become greedy for the solution, until a policy
        # comes for the second time; the result is the solution that this policy is greedy for. If no action
        # has changed, the iteration has converged. With one-hot features it always does, since each policy
        # has values at least as high as the one before; with others, policies may cycle or change
        # irregularly. In a cycle, the first repeated policy follows from the policies alone, which are
        # compared by their hashes. Changes of the weights would not do: the two changes of a cycle of two
        # policies are equal, and rounding would decide which is returned. They end an irregular iteration
        # only: `growths` counts how often the weights changed no less than with the policy before.
        #
        # All lanes take all steps together, each in a phase of its own: Q or U (`is_u`), a new policy or the
        # same one again with an inverse of its own (not `is_similar`). One loop with masks serves both
        # phases: Q and U in two loops would wait for the slowest lane twice, and compile the step twice.
        def step(loop):
            number, mean, change, growths, inverse, is_similar, seen, is_u, going = loop
            policy = policy_of(mean)
            # A policy whose solution was discarded has not been seen: it is tried again.
            is_before = jnp.arange(self.max_sweeps, dtype=jnp.int32) < number
            is_u = is_u | jnp.any(is_before & jnp.all(seen == policy.signature[None], axis=1))
            equations = policy.equations(is_u)
            # The matrices of successive policies differ little: the inverse for one preconditions the
            # equations of the next ones, which then take a few products with the features. It is renewed
            # where they did not converge, and at the start. A loop of one step in place of a branch: if only
            # a few lanes need an inverse, `while_going` computes it for those alone.
            inverse, _ = while_going(
                lambda loop: loop[1],
                lambda _, loop: (jnp.where(loop[1], equations.inverse(), loop[0]), jnp.zeros((), bool)),
                (inverse, going & ~is_similar),
            )
            before = jnp.where(is_u, mean[:, U], mean[:, Q])
            after, is_solved = equations.solution(inverse, before, going)
            # A solution that does not converge is discarded: the same policy then gets its own inverse, which
            # also serves the following policies. With its own inverse, a solution is taken as it is.
            is_taken = going & (is_solved | ~is_similar)
            is_new = is_taken & (jnp.where(is_u, U, Q) == jnp.arange(2))
            mean = jnp.where(is_new[None, :], after[:, None], mean)
            seen = jnp.where(is_taken, seen.at[number].set(policy.signature, mode="drop"), seen)
            number = number + is_taken.astype(number.dtype)
            last_change, change = change, jnp.where(is_taken, jnp.linalg.norm(after - before), change)
            growths = growths + (is_taken & (change >= last_change)).astype(growths.dtype)
            is_end = ~(change > self.tolerance) | (growths == 2) | (number >= self.max_sweeps)
            # The last solution of Q is followed by one of U, for the policy greedy for that Q; then the lane
            # ends.
            is_last = is_taken & (is_u | is_end)
            is_u, going = is_u | is_last, going & ~(is_last & is_u)
            return number, mean, change, growths, inverse, is_taken | ~going, seen, is_u, going

        zero, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
        infinite, inverse = jnp.full((), jnp.inf, mean.dtype), jnp.zeros((len(mean), len(mean)), mean.dtype)
        seen = jnp.zeros((self.max_sweeps, 2), jnp.uint32)
        loop = zero, mean, infinite, zero, inverse, no, seen, no, is_active
        loop = batched_together(loop)
        return jax.lax.while_loop(lambda loop: any_lane(loop[-1]), step, loop)[1]

    def _swept_u(
        self,
        sweep: Callable[[Int[Array, ""], Float[Array, "M"]], Float[Array, "M"]],
        mean: Float[Array, "M 2"],
        is_active: Bool[Array, ""],
    ) -> Float[Array, "M 2"]:
        """The means with that of U swept until it has converged."""
        return mean.at[:, U].set(self._until_converged(sweep, mean[:, U], is_active))

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
    return jax.vmap(lambda form: row_sums(matmul_on_tensor_cores(x, form) * x), out_axes=1)(forms)


def _salts(index: Int[Array, "B"]) -> UInt32[Array, "B 2"]:
    """Two numbers for each transition, as good as random.

    The sum of the choices of a policy times these numbers, modulo 2^32, is a hash. Those of two policies are
    equal with a probability of 2^-56 or so. (The numbers are those that MurmurHash3 ends with.)
    """
    x = 2 * index.astype(jnp.uint32)[:, None] + jnp.arange(1, 3, dtype=jnp.uint32)[None]
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        x = (x ^ (x >> shift)) * jnp.asarray(factor, jnp.uint32)
    return x ^ (x >> 16)


def _largest_block(block: int) -> int:
    """Number of transitions in a block on this machine."""
    return min(block, MOST_ON_CPU) if jax.default_backend() == "cpu" else block


def _features(state: EMUQState, memory: Memory) -> tuple[Float[Array, "B M"], Float[Array, "B P"]]:
    """phi(s, a) and x(s') of some transitions."""
    phi = jax.vmap(state.features)(memory.observations, memory.actions)
    return phi, jax.vmap(state.features.state)(memory.next_observations)
