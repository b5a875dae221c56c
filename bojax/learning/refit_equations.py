"""The linear equations of Q and of U for a given policy, and how they follow when the policy changes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.memory import Memory
from bojax.learning.refit_policy import Candidates, Policy
from bojax.learning.refit_rows import features_of
from bojax.numerics.lanes import any_lane, batched_together, largest_in_lanes
from bojax.numerics.linalg import matmul, matmul_on_tensor_cores, solve_large

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
        number, wide = len(state.posterior.base), _widest()
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


def _widest() -> jnp.dtype:
    """The precision of the equations: float64, unless JAX is set to float32."""
    return jnp.zeros((), float).dtype
