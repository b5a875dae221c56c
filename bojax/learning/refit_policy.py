"""The greedy policy of a refit of EMU-Q at all transitions."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from bojax.envs.base import Action
from bojax.learning.emu_q_model import EMUQModel, EMUQState, Q, U
from bojax.learning.features import StateActionFeatures
from bojax.learning.memory import Memory
from bojax.learning.refit_rows import Transitions
from bojax.numerics.linalg import matmul_on_tensor_cores, row_sums


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

        variances = None if self.covariance is None else self._variances(self.covariance, q.shape[1])

        def choose(x):
            if variances is None:
                scores, factors = matmul_on_tensor_cores(x, (q + u).T), jnp.ones((len(x), 1), x.dtype)
            else:
                factors = self.model.u_factor(variances(x))
                scores = matmul_on_tensor_cores(x, q.T) + matmul_on_tensor_cores(x, u.T) * factors
            chosen = jnp.argmax(scores, axis=1).astype(jnp.int32)
            factors = jnp.broadcast_to(factors, scores.shape)
            return chosen, jnp.take_along_axis(factors, chosen[:, None], axis=1)[:, 0]

        return choose

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
