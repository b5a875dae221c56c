"""Trust region policy optimisation (Schulman et al., ICML 2015, Section 6 and Appendix C)."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Bool, Float

from bojax.learning.networks import PolicyNetwork
from bojax.numerics.lanes import any_lane

_TOLERANCE = 1e-5  # norm of the residual at which conjugate gradients stop
_SMALL = 1e-8  # added to x'Fx, so that a gradient of 0 makes no step

P = TypeVar("P")


class Samples(eqx.Module):
    """Actions that a policy drew, and their advantages."""

    inputs: Float[Array, "N I"]  # inputs of the policy's network
    actions: Array  # actions, `[N, ...]`
    advantages: Float[Array, "N"]
    is_valid: Bool[Array, "N"]  # which rows count

    def mean(self, values: Float[Array, "N"]) -> Float[Array, ""]:
        """Mean over the valid rows."""
        number = jnp.maximum(jnp.sum(self.is_valid), 1).astype(values.dtype)
        return jnp.sum(jnp.where(self.is_valid, values, 0.0)) / number


class TRPO(eqx.Module):
    """The largest improvement of the surrogate advantage within a mean KL divergence of `max_kl`.

    The fields are settings of `bojax.learning.settings.VIME`.
    """

    max_kl: Float[Array, ""]
    damping: Float[Array, ""]
    backtrack_ratio: Float[Array, ""]
    cg_steps: int = eqx.field(static=True)
    backtracks: int = eqx.field(static=True)

    def surrogate(self, policy: PolicyNetwork, new: PolicyNetwork, samples: Samples) -> Float[Array, ""]:
        """Mean advantage, weighted by the ratio of the new policy's probabilities to the old ones."""

        def log_ratio(inputs, action):
            return new(inputs).log_probability(action) - policy(inputs).log_probability(action)

        log_ratios = jax.vmap(log_ratio)(samples.inputs, samples.actions)
        ratios = jnp.exp(jnp.where(samples.is_valid, log_ratios, 0.0))
        return samples.mean(ratios * samples.advantages)

    def mean_kl(self, policy: PolicyNetwork, new: PolicyNetwork, samples: Samples) -> Float[Array, ""]:
        """Mean KL divergence of the old policy's distributions from the new ones."""
        return samples.mean(jax.vmap(lambda inputs: policy(inputs).kl(new(inputs)))(samples.inputs))

    def fisher_product(self, policy: PolicyNetwork, samples: Samples, vector: P) -> P:
        """The Fisher matrix, which is the Hessian of `mean_kl`, times a tree of the policy's structure."""
        # A Hessian-vector product, the derivative of the gradient along the vector: the matrix is never
        # formed.
        gradient = jax.grad(lambda new: self.mean_kl(policy, new, samples))
        return jax.jvp(gradient, (policy,), (vector,))[1]

    def improved(self, policy: PolicyNetwork, samples: Samples, is_active: Bool[Array, ""]) -> PolicyNetwork:
        """The policy after a step along the natural gradient; unchanged if none succeeds or not active."""
        # At first the step is as long as the quadratic model of the divergence permits. It is shortened until
        # the surrogate increases and the divergence is within the bound.
        start, unravel = ravel_pytree(policy)

        @jax.jit  # traced and lowered once: `cg` calls it six times
        def product(vector):
            image = ravel_pytree(self.fisher_product(policy, samples, unravel(vector)))[0]
            return image + self.damping * vector

        value, gradient = jax.value_and_grad(lambda new: self.surrogate(policy, new, samples))(policy)
        gradient = ravel_pytree(gradient)[0]
        direction, _ = cg(product, gradient, tol=0.0, atol=_TOLERANCE, maxiter=self.cg_steps)
        curvature = jnp.vdot(direction, product(direction), precision=jax.lax.Precision.HIGHEST)
        longest = jnp.sqrt(2.0 * self.max_kl / (curvature + _SMALL))

        # Lanes that have found a step, or are not active, keep theirs while the others go on.
        def attempt(loop):
            number, factor, best, searches = loop
            theta = start + factor * longest * direction
            new = unravel(theta)
            is_better = self.surrogate(policy, new, samples) > value
            is_found = searches & is_better & (self.mean_kl(policy, new, samples) <= self.max_kl)
            best = jnp.where(is_found, theta, best)
            return number + 1, factor * self.backtrack_ratio, best, searches & ~is_found

        def is_searching(loop):
            return (loop[0] < self.backtracks) & any_lane(loop[3])

        loop = jnp.zeros((), jnp.int32), jnp.ones_like(self.max_kl), start, is_active
        return unravel(jax.lax.while_loop(is_searching, attempt, loop)[2])
