"""Beliefs of a Gaussian process along a simulated path, conditioned on imagined observations without a refit.

This is the belief tree of field monitoring in Schur form. The posterior given the real data is factorised
once for each plan, at the root. A path from the root adds the points Z, in stages of a few points. Their
joint posterior covariance is the Schur complement C = k(Z, Z) - V'V with V = L^-1 k(X, Z), and one small
Cholesky factor of C + noise I gives the belief before every stage: the rows of the stage and the columns of
earlier stages hold the covariance that the earlier stages explain. An imagined observation is
`mean + factor row * innovations` with independent standard normal innovations, so the innovations determine
the observations and are stored in their place.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bojax.models import lookahead_kernels as kernels
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.information import Places
from bojax.numerics.linalg import guarded_cholesky, matmul
from bojax.numerics.pallas import either


class LookaheadRoot(eqx.Module):
    """The posterior at the root, with quantities that all nodes of a plan share.

    Attributes:
        posterior: Belief at the root.
        whitened: L^-1 (y - m(X)).
        weights: (K + noise)^-1 (y - m(X)).
        places: Places whose variance counts; None if nothing asks for them.
    """

    posterior: GaussianProcess
    whitened: Float[Array, "N"]
    weights: Float[Array, "N"]
    places: Places | None = None

    @classmethod
    def of(cls, posterior: GaussianProcess, places: Places | None = None) -> "LookaheadRoot":
        """The root of a plan with this posterior."""
        return cls(posterior, posterior.whitened_residuals(), posterior.weights(), places)


class Lookahead(eqx.Module):
    """Beliefs about the points of each stage, before the observations of that stage.

    Attributes:
        mean: Posterior means.
        variance: Posterior variances of the noise-free function.
        gradient: Gradients of the posterior means; None unless requested.
    """

    mean: Float[Array, "B"]
    variance: Float[Array, "B"]
    gradient: Float[Array, "B D"] | None


def look_ahead(
    root: LookaheadRoot,
    points: Float[Array, "B D"],
    is_observed: Bool[Array, "B"],
    innovations: Float[Array, "B"],
    num_stages: int,
    with_gradient: bool = False,
) -> Lookahead:
    """Beliefs about the points of each stage, given the real data and the imagined observations before it.

    The beliefs equal those of a refit with real and imagined observations. The observations of stage j are
    `mean_j + (Cholesky factor of C_j + noise I) innovations_j`, with the moments of the belief before it.

    Args:
        root: The posterior at the root.
        points: Points of all stages, B / num_stages in each.
        is_observed: Whether a point is observed; the belief about any other point is undefined.
        innovations: Standard normal numbers; zeros make every imagined observation the predictive mean.
        num_stages: Number of stages.
        with_gradient: Whether to compute gradients.
    """
    posterior, number = root.posterior, points.shape[0]
    kernel = posterior.kernel
    # The number of real data differs between lanes, the arrays do not: all products run over the capacity,
    # where the empty rows and columns of L^-1 are zero; the kernels for NVIDIA GPUs skip them.
    stage = jnp.arange(number, dtype=jnp.int32) // (number // num_stages)
    both = is_observed[:, None] & is_observed[None, :]
    num_given = number - number // num_stages  # no stage is conditioned on the last one
    computed = functools.partial(either, kernels.are_used(number, num_given, posterior.y.dtype))

    at_data = posterior.inverse_cholesky, kernel.gram(posterior.x, points), posterior.count
    whitened = computed(kernels.whitened, _whitened, *at_data)  # V, [N, B]
    covariance = kernel.gram(points, points) - matmul(whitened.T, whitened)  # the Schur complement C
    noise = posterior.noise(points)
    # A point that is not observed becomes independent of all others, with an innovation of 0: it does not
    # change them, and no shape depends on how many samples a drive has taken.
    own = jnp.where(is_observed, noise, 1.0)
    joint = jnp.where(both, covariance, 0.0) + jnp.diag(own)
    least = jnp.where(is_observed, noise, 0.0)
    innovations = jnp.where(is_observed, innovations, 0.0)[:num_given]
    how = {"num_stages": num_stages, "with_weights": with_gradient}
    by_kernel, by_xla = (functools.partial(form, **how) for form in (kernels.conditioned, conditioned))
    shift, explained, imagined = computed(by_kernel, by_xla, joint, least, innovations)

    # (2.28) and (2.29) with the real data, then the corrections by the imagined observations of earlier
    # stages.
    mean = jax.vmap(posterior.mean)(points) + matmul(root.whitened, whitened) + shift
    variance = jnp.diagonal(covariance) - explained
    gradient = None
    if imagined is not None:
        # The mean as a weighted sum of kernels at the real data and at the imagined observations, which can
        # be differentiated at each point: weights (K + noise)^-1 (y - m) of both, by the block inverse. The
        # product is with all of V, padded with zeros, since a part of V would be copied first; and with the
        # rows of L^-1 as stored, which takes a third of the time of a product with L^-T.
        rows = matmul(jnp.pad(imagined.T, ((0, 0), (0, number - num_given))), whitened.T)
        args = rows, posterior.inverse_cholesky, posterior.count
        real = root.weights[None, :] - computed(kernels.explained_away, _product, *args)  # [stages, N]

        others = jnp.concatenate([posterior.x, points[:num_given]])
        weights = jnp.concatenate([real, imagined.T], axis=1)[stage]

        def mean_at(x, weights):
            return posterior.mean(x) + jnp.sum(jax.vmap(lambda z: kernel(x, z))(others) * weights)

        # Forward mode: on a GPU it takes two kernels as large as k(X, Z), and reverse mode three.
        gradient = jax.vmap(jax.jacfwd(mean_at))(points, weights)
    return Lookahead(mean, jnp.maximum(variance, 0.0), gradient)


def conditioned(
    joint: Float[Array, "B B"],
    least: Float[Array, "B"],
    innovations: Float[Array, "G"],
    num_stages: int,
    with_weights: bool,
) -> tuple[Float[Array, "B"], Float[Array, "B"], Float[Array, "G T"] | None]:
    """What the observations of the earlier stages say about the points of each stage.

    Args:
        joint: Covariance matrix of all observations given the real data.
        least: Their noise variances.
        innovations: Those of all stages but the last.
        num_stages: Number T of stages.
        with_weights: Whether to compute the last result.

    Returns:
        What is added to the means, what is subtracted from the variances, and the weights of the
        observations in the means of each stage.
    """
    number, num_given = len(joint), len(innovations)
    stage = jnp.arange(number, dtype=jnp.int32) // (number // num_stages)
    # No stage is conditioned on the last one, so its columns are not needed.
    factor, inverse = guarded_cholesky(joint, least, num_given)
    explained = jnp.where(stage[None, :num_given] < stage[:, None], factor, 0.0)
    weights = None
    if with_weights:
        # Innovations of the stage itself and of later stages are set to 0, so that one product serves all.
        stages = jnp.arange(num_stages, dtype=jnp.int32)
        given = jnp.where(stage[:num_given, None] < stages[None, :], innovations[:, None], 0.0)
        weights = matmul(inverse.T, given)
    return matmul(explained, innovations), jnp.sum(explained * explained, axis=-1), weights


def _whitened(inverse: Array, covariances: Array, count: Array) -> Array:
    """L^-1 times covariances, as the transpose of a product with L^-T."""
    # The product V'V reads V by columns: stored as rows, they are not copied first. On a CPU, a single plan
    # with 192 observations takes 0.86 times as long.
    return matmul(covariances.T, inverse.T).T


def _product(a: Array, b: Array, count: Array) -> Array:
    """A product with L^-1 of `count` observations."""
    return matmul(a, b)
