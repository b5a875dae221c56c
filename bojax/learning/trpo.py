"""Trust region policy optimisation (Schulman et al., ICML 2015, Section 6 and Appendix C); advantages."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Bool, Float, Int

from bojax.learning.networks import PolicyNetwork
from bojax.numerics.lanes import any_lane
from bojax.numerics.linalg import inverse_cholesky, matmul

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


_RIDGE = 1e-5  # ridge of the baseline's fit, relative to the mean square of each feature


def discounted_sums(
    terms: Float[Array, "N"], is_last: Bool[Array, "N"], factor: Float[Array, ""]
) -> Float[Array, "N"]:
    """Sum of each term and the later ones of its episode, each step discounted by `factor`."""
    # x_t = term_t + factor_t x_(t+1), with a factor of 0 at the end of an episode: compositions of affine
    # maps, which are associative, so that a scan from the end takes log N steps instead of N.
    factors = jnp.where(is_last, jnp.zeros_like(factor), factor)

    def join(later, earlier):
        return later[0] * earlier[0], earlier[1] + earlier[0] * later[1]

    return jax.lax.associative_scan(join, (factors, terms), reverse=True)[1]


def td_errors(
    rewards: Float[Array, "N"],
    values: Float[Array, "N"],
    is_last: Bool[Array, "N"],
    discount: Float[Array, ""],
) -> Float[Array, "N"]:
    """The errors r + gamma V(s') - V(s), whose sums discounted by gamma lambda are generalised advantages.

    Generalised advantage estimation is that of Schulman et al. (ICLR 2016). `values` are V of the states
    before the steps. The value after the last step of an episode is 0, even after a time limit, as in the
    published code of VIME.
    """
    after = jnp.where(is_last, jnp.zeros_like(values), jnp.append(values[1:], values[:1]))
    return rewards + discount * after - values


class LinearBaseline(eqx.Module):
    """Returns as a linear function of the observation, its square, and the first three powers of time.

    The baseline of rllab (Duan et al., ICML 2016), with the features o, o^2, t/100, (t/100)^2, (t/100)^3 and
    1; observations are clipped to [-10, 10]. That code adds 1e-5 to the diagonal of the normal equations and
    solves them by a singular value decomposition. Here the features are scaled to a mean square of 1 first,
    so that a Cholesky factor exists even in single precision.
    """

    weights: Float[Array, "F"]  # weight of each feature

    @classmethod
    def zero(cls, num_dims: int, dtype: jnp.dtype) -> "LinearBaseline":
        """The baseline that is 0 for observations of this size."""
        return cls(jnp.zeros((2 * num_dims + 4,), dtype))

    @classmethod
    def fit(
        cls,
        observations: Float[Array, "N D"],
        steps: Int[Array, "N"],
        returns: Float[Array, "N"],
        is_valid: Bool[Array, "N"],
    ) -> "LinearBaseline":
        """The baseline of least squared error on the valid rows."""
        features = jnp.where(is_valid[:, None], _features(observations, steps), 0.0)
        number = jnp.maximum(jnp.sum(is_valid), 1).astype(features.dtype)
        scale = jnp.sqrt(jnp.sum(features**2, axis=0) / number)
        scale = jnp.where(scale > 0.0, scale, 1.0)
        features = features / scale[None]
        gram = matmul(features.T, features) / number + _RIDGE * jnp.eye(len(scale), dtype=features.dtype)
        inverse = inverse_cholesky(gram)
        products = matmul(features.T, jnp.where(is_valid, returns, 0.0)) / number
        return cls(matmul(inverse.T, matmul(inverse, products)) / scale)

    def predict(self, observations: Float[Array, "N D"], steps: Int[Array, "N"]) -> Float[Array, "N"]:
        """Expected return from each observation, given the number of steps before it in its episode."""
        return matmul(_features(observations, steps), self.weights)


def _features(observations: Float[Array, "N D"], steps: Int[Array, "N"]) -> Float[Array, "N F"]:
    clipped = jnp.clip(observations, -10.0, 10.0)
    time = steps.astype(clipped.dtype)[:, None] / 100.0
    return jnp.concatenate([clipped, clipped**2, time, time**2, time**3, jnp.ones_like(time)], axis=1)
