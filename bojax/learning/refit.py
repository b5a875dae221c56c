"""The fit of Q and U to all transitions at the end of an episode of EMU-Q (Algorithm 6, lines 14 to 17).

The covariance S stays the same; the TD targets are those of the current policy pi. The means are fitted
either by sweeps, m <- beta S Phi'(r + gamma Phi_next m), or by solving the equations that the sweeps converge
to, ((alpha / beta) I + Phi'(Phi - gamma Phi_next)) m = Phi'r.
"""

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action
from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.memory import Memory
from bojax.learning.refit_policy import (
    Candidates,
    Policy,
    Transitions,
    features_of,
    largest_block,
    quadratic_forms,
)
from bojax.numerics.lanes import any_lane, batched_together, largest_in_lanes
from bojax.numerics.linalg import matmul, matmul_on_tensor_cores, row_sums, solve_large
from bojax.numerics.stragglers import while_going

CHANGED, CHANGED_ON_CPU = 512, 128
"""Number of changed transitions that are added to the equations at a time."""

COMPARED = 4096  # number of transitions whose actions are compared at a time

NONE = -1  # index of the action a' of a transition that is not in the equations


class Equations(eqx.Module):
    """The equations K m = Phi'c, with K = (alpha / beta) I + Phi'(Phi - D Phi_next).

    They are beta S Phi'(c + D Phi_next m) = m, times (beta S)^-1. Targets of Q and of U differ in their
    constants c and discounts D; K is that of one of them.
    """

    matrix: Float[Array, "M M"]  # K
    constants: Float[Array, "M 2"]  # Phi'c of Q and of U
    chosen: Int[Array, "C"]  # index of a' of every transition among the candidates, or `NONE`
    discounts: Float[Array, "C"]  # the diagonal of D
    is_solved: Bool[Array, ""]  # whether `solutions` are those of K
    solutions: Float[Array, "M 2"]  # the weights of Q and of U that solve equations with K

    @classmethod
    def empty(cls, model: EMUQModel, state: EMUQState) -> "Equations":
        """The equations without any transition."""
        number = len(state.posterior.base)
        wide = jnp.result_type(float)  # float64, unless JAX is set to float32
        ratio = model.prior_precision.astype(wide) / model.noise_precision.astype(wide)
        matrix = ratio * jnp.eye(number, dtype=wide)
        none = jnp.full(state.memory.rewards.shape, NONE, jnp.int32)
        zeros, discounts = jnp.zeros((number, 2), wide), jnp.zeros_like(state.memory.rewards)
        return cls(matrix, zeros, none, discounts, jnp.zeros((), bool), zeros)

    def followed(
        self,
        candidates: Candidates,
        state: EMUQState,
        bonus: Float[Array, "C"],
        policy: Policy,
        is_u: Bool[Array, ""],
    ) -> "Equations":
        """The equations of another policy, of U if `is_u`, or else of Q.

        Only transitions whose action or discount changes are visited. `bonus` is the exploration reward of
        every transition.
        """
        memory = state.memory
        discounts, changed, number = self._changes(candidates.model, memory, policy, is_u)
        size = CHANGED_ON_CPU if jax.default_backend() == "cpu" else CHANGED
        before, after = (self.chosen, self.discounts), (policy.chosen, discounts)

        def add(part, sums):
            place = part * size + jnp.arange(size, dtype=jnp.int32)
            index = changed.at[place].get(mode="fill", fill_value=0)
            rows = jax.tree.map(lambda x: x[index] if x.ndim else x, memory)
            phi, x = features_of(state, rows)
            phi = jnp.where((place < number)[:, None], phi, 0.0)
            # A transition that enters the equations adds phi phi' and its constants, once for all policies.
            enters = (self.chosen[index] == NONE)[:, None]
            right = jnp.where(enters, phi, 0.0)
            for sign, chosen, discounts in ((1.0, *before), (-1.0, *after)):
                following = candidates.next_features(x, chosen[index])
                right = right + sign * discounts[index][:, None] * following
            terms = jnp.where(enters, candidates.constants(rows, bonus[index]), 0.0)
            # In float32 and added in float64: on a CPU, products in float64 take four times as long. The
            # solutions of the lander, where K has a condition of 2e6, are accurate to 3e-4 in the median.
            products = matmul_on_tensor_cores(phi.T, right), matmul_on_tensor_cores(phi.T, terms)
            return tuple(a + b.astype(a.dtype) for a, b in zip(sums, products, strict=True))

        sums = batched_together((self.matrix, self.constants))
        parts = (largest_in_lanes(number) + size - 1) // size
        matrix, constants = jax.lax.fori_loop(0, parts, add, sums)
        is_solved = self.is_solved & (number == 0)
        return Equations(matrix, constants, *after, is_solved, self.solutions)

    def solved(self, is_active: Bool[Array, ""]) -> "Equations":
        """The equations with their solutions; those of lanes that are not active may be left out."""
        is_left = is_active & ~self.is_solved
        solutions = jax.lax.cond(
            any_lane(is_left),
            lambda: jnp.where(is_left, solve_large(self.matrix, self.constants), self.solutions),
            lambda: self.solutions,
        )
        where = lambda equations: (equations.is_solved, equations.solutions)  # noqa: E731
        return eqx.tree_at(where, self, (self.is_solved | is_left, solutions))

    def _changes(
        self, model: EMUQModel, memory: Memory, policy: Policy, is_u: Bool[Array, ""]
    ) -> tuple[Float[Array, "C"], Int[Array, "C"], Int[Array, ""]]:
        """The discounts of a policy; the transitions whose action or discount changes, and their number."""
        u_discounts = model.u_terms(memory.rewards, policy.factors, memory.terminated)[1]
        discounts = jnp.where(is_u, u_discounts, model.q_discount(memory.terminated))
        capacity = len(discounts)

        def visit(carry, rows, index, is_valid):
            changed, number = carry
            of = lambda x: jax.lax.dynamic_slice_in_dim(x, index[0], len(index))  # noqa: E731
            differs = (of(policy.chosen) != of(self.chosen)) | (of(discounts) != of(self.discounts))
            differs = differs & is_valid
            # Positions past the end, distinct so that XLA may scatter without atomic operations, are dropped.
            place = jnp.where(differs, number + jnp.cumsum(differs, dtype=jnp.int32) - 1, capacity + index)
            changed = changed.at[place].set(index, mode="drop", unique_indices=True)
            return changed, number + jnp.sum(differs, dtype=jnp.int32)

        start = jnp.zeros((capacity,), jnp.int32), jnp.zeros((), jnp.int32)
        changed, number = memory.fold(visit, start, COMPARED)
        return discounts, changed, number

    def residual(self, weights: Float[Array, "M"], is_u: Bool[Array, ""] | bool) -> Float[Array, "M"]:
        """Phi'c - K m for the weights m of U if `is_u`, or else of Q, in the precision of the weights."""
        constants = jnp.where(is_u, self.constants[:, U], self.constants[:, Q])
        product = matmul(self.matrix, weights.astype(self.matrix.dtype))
        return (constants - product).astype(weights.dtype)


class Refit(EMUQModel):
    """The part of `EMUQ` that fits the means of Q and U to all transitions."""

    tolerance: Float[Array, ""]
    refit: Literal["sweeps", "direct", "none"] = eqx.field(static=True)
    max_sweeps: int = eqx.field(static=True)
    refit_block: int = eqx.field(static=True)

    def refitted(
        self, key: Key[Array, ""], state: EMUQState, kappa: Float[Array, ""], is_active: Bool[Array, ""]
    ) -> Float[Array, "M 2"]:
        """The fitted means of Q and U; unchanged if not active.

        Lines 14 and 15 fit Q, with a' chosen anew by Q + kappa U in every sweep or solution. Lines 16 and 17
        compute the exploration rewards (5.12), unless they were stored, and fit U, with a' chosen once.

        The thesis does not say over which actions the policy maximises: every sweep draws its own candidates,
        as the published code does; a direct solution, which that code lacks, draws them once.
        """
        key_q, key_u = jax.random.split(key)
        is_direct = self.refit == "direct"
        is_linear = is_direct and not self.clips_u
        transitions = Transitions.of(state, largest_block(self.refit_block), with_phi=not is_linear)
        mean = state.posterior.mean
        gain = self.noise_precision * state.posterior.base
        drawn, samples = self.actions(key_u, state)
        stored = state.stored
        bonus = self._exploration_rewards(state, samples) if stored is None else stored.values
        candidates = Candidates.of(self, state, drawn, kappa)
        if is_direct:
            # With one set of candidates there are finitely many policies, which usually settle after a few.
            solution = self._solve(transitions, candidates, bonus, mean, is_active)
            if is_linear:
                return solution
            # The equations with clipped values are not linear. Sweeps of bounded targets follow the solution
            # of the linear ones; they end at once where it leaves no bound.
            before = solution.at[:, U].set(mean[:, U])
            clipped = self._clipped_sweep(transitions, candidates, bonus, before)
            return self._swept_u(lambda u: matmul(gain, clipped(u)), solution, is_active)

        # Lines 14-15: m_Q <- beta S Phi'(r + gamma Phi_next m_Q), with a' greedy for the current m_Q and m_U.
        def sweep(number, q):
            actions, _ = self.actions(jax.random.fold_in(key_q, number), state)
            anew = Candidates.of(self, state, actions, kappa)
            values = anew.values(mean.at[:, Q].set(q), q)

            def visit(total, rows):
                target = rows.memory.rewards + self.q_discount(rows.memory.terminated) * values(rows.x)
                return total + matmul(rows.valid(target), rows.phi)

            return matmul(gain, transitions.fold(visit, jnp.zeros_like(q)))

        mean = mean.at[:, Q].set(self._until_converged(sweep, mean[:, Q], is_active))
        if self.clips_u:
            clipped = self._clipped_sweep(transitions, candidates, bonus, mean)
            return self._swept_u(lambda u: matmul(gain, clipped(u)), mean, is_active)
        # Lines 16-17. With a' fixed, a sweep is an affine map of the weights: one pass over the transitions
        # is enough. As beta S (K + Phi'D Phi_next) = I, it adds beta S times the residual of the equations.
        policy = Policy.of(transitions, candidates, mean)
        equations = Equations.empty(self, state)
        equations = equations.followed(candidates, state, bonus, policy, jnp.asarray(True))
        return self._swept_u(lambda u: u + matmul(gain, equations.residual(u, True)), mean, is_active)

    def _exploration_rewards(self, state: EMUQState, samples: Action) -> Float[Array, "C"]:
        """The exploration reward (5.12) of every transition, for the actions of `samples`."""
        features, memory = state.features, state.memory
        ys = jax.vmap(features.action)(samples)
        # The mean over the samples can be taken first, unless it is the published code's.
        groups = ys[:, None] if self.mixes_transitions else ys[None]
        forms = jax.vmap(lambda ys: features.mean_form(state.posterior.base, ys))(groups)

        # Computed once a refit, so x(s') is computed again here: reading the stored part would put a second
        # loop into the program.
        def visit(variances, rows, index, _):
            x = jax.vmap(features.state)(rows.next_observations)
            return jax.lax.dynamic_update_slice_in_dim(variances, quadratic_forms(x, forms), index[0], 0)

        start = jnp.zeros((len(memory.rewards), len(forms)), forms.dtype)
        variances = memory.fold(visit, start, largest_block(self.refit_block))
        return self.exploration_reward(self.mean_variances(variances, memory.count))

    def _clipped_sweep(
        self,
        transitions: Transitions,
        candidates: Candidates,
        bonus: Float[Array, "C"],
        mean: Float[Array, "M 2"],
    ) -> Callable[[Float[Array, "M"]], Float[Array, "M"]]:
        """Phi'(r_e + gamma clipped U) as a function of the weights of U, with a' greedy for `mean`."""
        policy = Policy.of(transitions, candidates, mean)

        def sweep(weights):
            split = candidates.split(weights)

            def visit(total, rows):
                value = self.clipped_u(row_sums(rows.x * split[rows.of(policy.chosen)]))
                terms = rows.of(bonus), rows.of(policy.factors), rows.memory.terminated
                constant, discount = self.u_terms(*terms)
                return total + matmul(rows.valid(constant + discount * value), rows.phi)

            return transitions.fold(visit, jnp.zeros_like(weights))

        return sweep

    def _solve(
        self,
        transitions: Transitions,
        candidates: Candidates,
        bonus: Float[Array, "C"],
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

        # All lanes take all steps together, each at Q or at U (`is_u`), until the few with most policies are
        # gathered. One loop with masks serves both: two loops would wait for the slowest lane twice. Lanes
        # that have ended keep their means, and nothing else of them is read afterwards.
        def step(_, loop):
            number, mean, change, growths, equations, seen, is_u, going = loop
            # Lanes that have ended visit no transitions, so that passes are as short as those of the others.
            count = jnp.where(going, transitions.state.memory.count, 0)
            visited = eqx.tree_at(lambda t: t.state.memory.count, transitions, count)
            policy = Policy.of(visited, candidates, mean)
            is_before = jnp.arange(self.max_sweeps, dtype=jnp.int32) < number
            is_u = is_u | jnp.any(is_before & jnp.all(seen == policy.signature[None], axis=1))
            equations = equations.followed(candidates, visited.state, bonus, policy, is_u)
            equations = equations.solved(going)
            before = jnp.where(is_u, mean[:, U], mean[:, Q])
            after = jnp.where(is_u, equations.solutions[:, U], equations.solutions[:, Q]).astype(mean.dtype)
            is_new = going & (jnp.where(is_u, U, Q) == jnp.arange(2))
            mean = jnp.where(is_new[None, :], after[:, None], mean)
            seen = jnp.where(going, seen.at[number].set(policy.signature, mode="drop"), seen)
            number = number + going.astype(number.dtype)
            last_change, change = change, jnp.where(going, jnp.linalg.norm(after - before), change)
            growths = growths + (going & (change >= last_change)).astype(growths.dtype)
            is_end = ~(change > self.tolerance) | (growths == 2) | (number >= self.max_sweeps)
            # The last solution of Q is followed by one of U, for the policy greedy for that Q; then the lane
            # ends.
            is_u, going = is_u | (going & is_end), going & ~is_u
            return number, mean, change, growths, equations, seen, is_u, going

        zero, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
        infinite = jnp.full((), jnp.inf, mean.dtype)
        equations = Equations.empty(self, transitions.state)
        seen = jnp.zeros((self.max_sweeps, 2), jnp.uint32)
        loop = zero, mean, infinite, zero, equations, seen, no, is_active
        return while_going(lambda loop: loop[-1], step, loop)[1]

    def _swept_u(
        self,
        sweep: Callable[[Float[Array, "M"]], Float[Array, "M"]],
        mean: Float[Array, "M 2"],
        is_active: Bool[Array, ""],
    ) -> Float[Array, "M 2"]:
        """The means, after sweeps of U until it has converged."""
        swept = self._until_converged(lambda _, u: sweep(u), mean[:, U], is_active)
        return mean.at[:, U].set(swept)

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
