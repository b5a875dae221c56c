"""The transitions that a refit of EMU-Q visits, and the greedy policy there."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt32

from bojax.envs.base import Action
from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.features import StateActionFeatures
from bojax.learning.memory import Memory, T
from bojax.numerics.linalg import matmul_on_tensor_cores, row_sums

# 8 MB a run for 500 features in float32. On a CPU, which stores the features of one run of a batch at a time,
# refits of the reacher with 2,600 to 4,600 transitions take two thirds of their time with 2,048. With 8,192,
# filling the arrays with zeros takes longer than a short refit.
NUM_STORED, NUM_STORED_ON_CPU = 2048, 4096
"""Largest number of transitions whose phi(s, a) and x(s') are stored during a refit: the first ones of a run.

Of x(s') alone, twice as many are stored.
"""

# The last block is padded. Blocks of 512, which need fewer launches on a GPU, take 2.8 times as long for 28
# transitions on a CPU, and as long for 2,500.
MOST_ON_CPU = 64  # largest block on a CPU


class Rows(eqx.Module):
    """A block of transitions and their features."""

    memory: Memory  # the transitions
    index: Int[Array, "B"]  # their positions
    is_valid: Bool[Array, "B"]  # which of them to count
    phi: Float[Array, "B M"]  # phi(s, a)
    x: Float[Array, "B P"]  # x(s')

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


class Transitions(eqx.Module):
    """All transitions of a run and their features, stored or recomputed."""

    state: EMUQState  # state of the learner
    phi: Float[Array, "T M"]  # phi(s, a) of the first transitions
    x: Float[Array, "T P"]  # x(s') of the first transitions
    block: int = eqx.field(static=True)  # number of transitions in a block
    stored_block: int = eqx.field(static=True)  # and in a block of those whose features are stored

    @classmethod
    def of(cls, state: EMUQState, block: int, with_phi: bool) -> "Transitions":
        """The transitions in memory, in blocks of at most `block`.

        Without `with_phi`, phi must not be read: XLA then does not store it.
        """
        number = NUM_STORED_ON_CPU if jax.default_backend() == "cpu" else NUM_STORED
        number = min(number if with_phi else 2 * number, len(state.memory.rewards))

        def visit(arrays, rows, index, is_valid):
            return tuple(
                jax.lax.dynamic_update_slice_in_dim(array, new, index[0], 0)
                for array, new in zip(arrays, features_of(state, rows), strict=True)
            )

        shapes = jax.eval_shape(features_of, state, state.memory)
        start = tuple(jnp.zeros((number, *shape.shape[1:]), shape.dtype) for shape in shapes)
        phi, x = state.memory.fold(visit, start, block, end=number)
        # On a GPU, XLA copies each block before its products. A sweep over all stored features as one block,
        # which is not copied, takes as long as over 512 transitions. Direct refits, which do not store phi,
        # would gain next to nothing.
        is_whole = with_phi and jax.default_backend() != "cpu"
        return cls(state, phi, x, block, number if is_whole else block)

    def fold(self, function, start):
        """Fold a function `(carry, rows) -> carry` over blocks of transitions, where `rows` is a `Rows`."""

        def stored(carry, memory, index, is_valid):
            phi, x = (jax.lax.dynamic_slice_in_dim(a, index[0], len(index)) for a in (self.phi, self.x))
            return function(carry, Rows(memory, index, is_valid, phi, x))

        def recomputed(carry, memory, index, is_valid):
            return function(carry, Rows(memory, index, is_valid, *features_of(self.state, memory)))

        # The first transitions are read from the arrays, later ones are computed again in every pass: stored,
        # they would take gigabytes in a batch.
        memory, number = self.state.memory, len(self.phi)
        carry = memory.fold(stored, start, self.stored_block, end=number)
        return memory.fold(recomputed, carry, self.block, first=number)


def largest_block(block: int) -> int:
    """Number of transitions in a block on this machine."""
    return min(block, MOST_ON_CPU) if jax.default_backend() == "cpu" else block


def features_of(state: EMUQState, memory: Memory) -> tuple[Float[Array, "B M"], Float[Array, "B P"]]:
    """phi(s, a) and x(s') of some transitions."""
    phi = jax.vmap(state.features)(memory.observations, memory.actions)
    return phi, jax.vmap(state.features.state)(memory.next_observations)


class Candidates(eqx.Module):
    """Actions over which a policy maximises Q + kappa U, and what does not depend on the weights."""

    model: EMUQModel  # model of Q and U
    features: StateActionFeatures  # feature map phi
    kappa: Float[Array, ""]  # weight of U
    ys: Float[Array, "J R"]  # features y(a) of the candidates
    covariance: Float[Array, "M M"] | None  # covariance of the weights; None if U needs no variance

    @classmethod
    def of(cls, model: EMUQModel, state: EMUQState, actions: Action, kappa: Float[Array, ""]) -> "Candidates":
        """The given actions as candidates."""
        features = state.features
        ys = jax.vmap(features.action)(actions)
        return cls(model, features, kappa, ys, state.posterior.base if model.optimistic_u else None)

    def split(self, weights: Float[Array, "M"]) -> Float[Array, "J P"]:
        """Weights of x(s') in the values of every candidate."""
        return jax.vmap(self.features.split, (None, 0))(weights, self.ys)

    def greedy(
        self, mean: Float[Array, "M 2"]
    ) -> Callable[[Float[Array, "B P"]], tuple[Int[Array, "B"], Float[Array, "B"]]]:
        """The policy pi = argmax Q + kappa U, as a function of x(s').

        It gives the index of the chosen candidate, and its factor of U.
        """
        # Features are bilinear: phi(s', a)'m = x(s')'split(m, y(a)). One product of x with a matrix gives the
        # values of all candidates, and phi(s', a) is computed only where U needs variances.
        q, u = self.split(mean[:, Q]), self.kappa * self.split(mean[:, U])
        sums = q + u  # out of the loop over transitions, where XLA would leave it
        variances = None if self.covariance is None else self._variances(self.covariance, q.shape[1])

        def choose(x):
            if variances is None:
                scores, factors = matmul_on_tensor_cores(x, sums.T), jnp.ones((len(x), 1), x.dtype)
            else:
                factors = self.model.u_factor(variances(x))
                scores = matmul_on_tensor_cores(x, q.T) + matmul_on_tensor_cores(x, u.T) * factors
            chosen = jnp.argmax(scores, axis=1).astype(jnp.int32)
            factors = jnp.broadcast_to(factors, scores.shape)
            return chosen, jnp.take_along_axis(factors, chosen[:, None], axis=1)[:, 0]

        return choose

    def values(
        self, mean: Float[Array, "M 2"], weights: Float[Array, "M"]
    ) -> Callable[[Float[Array, "B P"]], Float[Array, "B"]]:
        """phi(s', a')'weights for the action a' that is greedy for `mean`, as a function of x(s')."""
        choose, split = self.greedy(mean), self.split(weights)
        if jax.default_backend() == "cpu":
            return lambda x: row_sums(x * split[choose(x)[0]])

        # On a GPU, a second pass over x takes longer than the values of all candidates.
        def of(x):
            values = matmul_on_tensor_cores(x, split.T)
            return jnp.take_along_axis(values, choose(x)[0][:, None], axis=1)[:, 0]

        return of

    def _variances(
        self, covariance: Float[Array, "M M"], num_state_features: int
    ) -> Callable[[Float[Array, "B P"]], Float[Array, "B J"]]:
        """The variances phi(s', a)'S phi(s', a) of all candidates, as a function of x(s')."""
        features = self.features
        if num_state_features < len(covariance):  # of features that are products: smaller matrices
            forms = jax.vmap(lambda y: features.mean_form(covariance, y[None]))(self.ys)
            return lambda x: quadratic_forms(x, forms)

        # One product for all candidates. A form for each would take 1.4 times as long in a run of cartpole on
        # a CPU with sines, and four times the operations without.
        def of(y: Float[Array, "R"], x: Float[Array, "B P"]) -> Float[Array, "B"]:
            phi = jax.vmap(features.join, (0, None))(x, y)
            return row_sums(matmul_on_tensor_cores(phi, covariance) * phi)

        return lambda x: jax.vmap(of, (0, None), out_axes=1)(self.ys, x)

    def constants(self, rows: Memory, bonus: Float[Array, "B"]) -> Float[Array, "B 2"]:
        """Constant terms of the TD targets of Q and of U; `bonus` is the exploration reward."""
        of_u, _ = self.model.u_terms(bonus, jnp.ones_like(bonus), rows.terminated)
        return jnp.stack([rows.rewards, of_u], axis=1)

    def next_features(self, x: Float[Array, "B P"], chosen: Int[Array, "B"]) -> Float[Array, "B M"]:
        """phi(s', a') of the chosen candidates."""
        return jax.vmap(self.features.join)(x, self.ys[chosen])


class Policy(eqx.Module):
    """A policy at the next states of all transitions."""

    chosen: Int[Array, "C"]  # index of a' = pi(s') among the candidates
    factors: Float[Array, "C"]  # factor of U of a' in the TD target of U
    signature: UInt32[Array, "2"]  # a hash of all choices

    @classmethod
    def of(cls, transitions: Transitions, candidates: Candidates, mean: Float[Array, "M 2"]) -> "Policy":
        """The greedy policy of the given means."""
        choose = candidates.greedy(mean)

        def visit(carry, rows):
            arrays, signature = carry
            chosen, factors = choose(rows.x)
            # The hash comes out of the same pass over the transitions.
            salted = _salts(rows.index) * chosen.astype(jnp.uint32)[:, None]
            signature = signature + jnp.sum(rows.valid(salted), axis=0, dtype=jnp.uint32)
            return rows.put(arrays, (chosen, factors)), signature

        rewards = transitions.state.memory.rewards
        none = jnp.zeros_like(rewards, jnp.int32), jnp.zeros_like(rewards)
        (chosen, factors), signature = transitions.fold(visit, (none, jnp.zeros(2, jnp.uint32)))
        return cls(chosen, factors, signature)


def quadratic_forms(x: Float[Array, "B P"], forms: Float[Array, "J P P"]) -> Float[Array, "B J"]:
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
