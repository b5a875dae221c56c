"""Hyper-parameters of greatest evidence (2.23, 2.30), by L-BFGS from several starts at once."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Key, PyTree

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel

LogPrior = Callable[[Kernel, Float[Array, ""]], Float[Array, ""]]
"""Logarithm of a density over a kernel and a noise variance, up to a constant."""


def log_normal_prior(
    kernel: Kernel, noise_variance: Float[Array, ""], spread: Float[Array, ""] | float
) -> LogPrior:
    """Log-normal densities of a kernel's numbers and of a noise variance, each with the one given as median.

    Args:
        kernel: Medians of the kernel's numbers.
        noise_variance: Median of the noise variance.
        spread: Standard deviation of the logarithms.
    """
    medians = jax.tree.leaves((kernel, noise_variance))

    def log_prior(kernel: Kernel, noise_variance: Float[Array, ""]) -> Float[Array, ""]:
        found = jax.tree.leaves((kernel, noise_variance))
        scores = [jnp.log(a / b) / spread for a, b in zip(found, medians, strict=True)]
        return sum((-0.5 * jnp.sum(score**2) for score in scores), jnp.zeros_like(noise_variance))

    return log_prior


class Optimum(eqx.Module):
    """The best of what all starts came to.

    Attributes:
        params: Hyper-parameters, as they were given.
        value: The objective there; minus infinity if it was finite nowhere, and `params` are the first start.
        has_converged: Whether the gradient nearly vanishes there.
    """

    params: PyTree
    value: Float[Array, ""]
    has_converged: Bool[Array, ""]

    @property
    def is_finite(self) -> Bool[Array, "*batch"]:
        """Whether any start had a finite value."""
        return jnp.isfinite(self.value)


def maximise(
    objective: Callable[[PyTree], Float[Array, ""]],
    params: PyTree,
    key: Key[Array, ""],
    *,
    num_starts: int = 8,
    num_steps: int = 30,
    spread: float = 1.5,
    bounds: tuple[float, float] = (1e-6, 1e6),
) -> Optimum:
    """The positive parameters where an objective is greatest.

    The logarithm of each parameter is a sigmoid of what L-BFGS moves, which keeps it within the bounds. A
    step is only taken where the objective rises: a start that meets NaN stops where it was, and one that
    begins there never wins.

    Args:
        objective: A log evidence, with the log density of a prior added if there is one.
        params: The first start: a tree whose floating-point leaves are varied, all of them positive.
        key: For the other starts.
        num_starts: Number of starts.
        num_steps: The most steps from each of them.
        spread: Standard deviation of the logarithms of the other starts around the first.
        bounds: Least and greatest value of every parameter; starts are moved inside.
    """
    varied, fixed = eqx.partition(params, eqx.is_inexact_array)
    first, unravel = ravel_pytree(varied)
    low, high = (jnp.log(jnp.asarray(bound, first.dtype)) for bound in bounds)

    def params_at(point: Float[Array, "P"]) -> PyTree:
        return eqx.combine(unravel(jnp.exp(low + (high - low) * jax.nn.sigmoid(point))), fixed)

    def loss(point: Float[Array, "P"]) -> Float[Array, ""]:
        return -objective(params_at(point))

    def climb(point: Float[Array, "P"]) -> _Place:
        value, gradient = jax.value_and_grad(loss)(point)
        place = _Place(point, value, gradient)
        is_active = jnp.isfinite(value) & ~place.is_stationary()
        carry = place, solver.init(point), jnp.zeros((), jnp.int32), is_active
        return jax.lax.while_loop(lambda carry: carry[3] & (carry[2] < num_steps), step, carry)[0]

    def step(carry):
        place, state, number, is_active = carry
        # In a batch a start that has arrived walks on with the others: without a gradient it stands still,
        # where it would search its line in vain, and the others would wait for it.
        gradient = jnp.where(is_active, place.gradient, 0.0)
        with jax.numpy_dtype_promotion("standard"):  # optax adds integers of two widths
            updates, state = solver.update(
                gradient, state, place.point, value=place.value, grad=gradient, value_fn=loss
            )
        value, gradient = (optax.tree_utils.tree_get(state, name) for name in ("value", "grad"))
        new = _Place(place.point + updates, value, gradient)
        is_better = is_active & new.is_finite() & (value < place.value)
        place = jax.tree.map(lambda a, b: jnp.where(is_better, a, b), new, place)
        return place, state, number + 1, is_better & ~place.is_stationary()

    solver = optax.lbfgs()
    away = jax.random.normal(key, (num_starts, first.shape[0]), first.dtype).at[0].set(0.0)
    share = (jnp.log(first)[None, :] + spread * away - low) / (high - low)
    starts = jax.scipy.special.logit(jnp.clip(share, 0.01, 0.99))
    best = jax.vmap(climb)(starts)
    values = jnp.where(jnp.isfinite(best.value), best.value, jnp.inf)
    place = jax.tree.map(lambda leaf: leaf[jnp.argmin(values)], best)
    is_finite = jnp.isfinite(place.value)
    found = params_at(place.point)
    return Optimum(
        params=jax.tree.map(lambda new, old: jnp.where(is_finite, new, old), found, params),
        value=-jnp.min(values),
        has_converged=is_finite & place.is_stationary(),
    )


class _Place(eqx.Module):
    """A point, the loss there and its gradient."""

    point: Float[Array, "P"]
    value: Float[Array, ""]
    gradient: Float[Array, "P"]

    def is_finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.value) & jnp.all(jnp.isfinite(self.gradient))

    def is_stationary(self) -> Bool[Array, ""]:
        # The gradient of an evidence is as exact as its conditioning allows, not as its digits do.
        tolerance = float(jnp.finfo(self.value.dtype).eps) ** 0.25 * (1.0 + jnp.abs(self.value))
        return jnp.max(jnp.abs(self.gradient)) <= tolerance


def relearn(
    gp: GaussianProcess,
    key: Key[Array, ""],
    *,
    learn_noise: bool = True,
    log_prior: LogPrior | None = None,
    noise_variances: Float[Array, "N"] | None = None,
    num_starts: int = 8,
    num_steps: int = 30,
    spread: float = 1.5,
    bounds: tuple[float, float] = (1e-6, 1e6),
) -> tuple[GaussianProcess, Optimum]:
    """The posterior with the hyper-parameters that explain its observations best, factored anew.

    The hyper-parameters that it has are the first start, and are kept unless better ones are found: without
    observations nothing changes. The prior mean is not learned.

    Args:
        gp: The posterior; all numbers of its kernel have to be positive.
        key: For the other starts.
        learn_noise: Whether to learn the noise variance too.
        log_prior: Logarithm of a prior density of the hyper-parameters, added to the evidence.
        noise_variances: Noise variances of the observations, if they came with their own: these are known.
        num_starts: See `maximise`.
        num_steps: See `maximise`.
        spread: See `maximise`.
        bounds: See `maximise`.
    """

    def refit(kernel: Kernel, noise_variance: Float[Array, ""]) -> GaussianProcess:
        return GaussianProcess.fit(
            kernel,
            noise_variance,
            gp.x,
            gp.y,
            mean=gp.mean,
            count=gp.count,
            noise_variances=noise_variances,
        )

    def objective(params) -> Float[Array, ""]:
        kernel, noise_variance = params
        noise_variance = gp.noise_variance if noise_variance is None else noise_variance
        return score(refit(kernel, noise_variance))

    def score(gp: GaussianProcess) -> Float[Array, ""]:
        evidence = gp.log_marginal_likelihood()
        return evidence if log_prior is None else evidence + log_prior(gp.kernel, gp.noise_variance)

    is_learned = learn_noise and noise_variances is None
    held = (gp.kernel, gp.noise_variance if is_learned else None)
    optimum = maximise(
        objective, held, key, num_starts=num_starts, num_steps=num_steps, spread=spread, bounds=bounds
    )
    # A value that is NaN is less than every number.
    is_better = optimum.is_finite & ~(score(gp) >= optimum.value)
    kernel, noise_variance = jax.tree.map(
        lambda found, given: jnp.where(is_better, found, given), optimum.params, held
    )
    return refit(kernel, gp.noise_variance if noise_variance is None else noise_variance), optimum
