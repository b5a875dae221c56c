"""Hyper-parameters that maximise the evidence (2.23, 2.30), by L-BFGS from several starting points."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Key, PyTree

from bojax.models.checks import check_count, compiled_if_known
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.numerics.lanes import batched_together

EDGE = 0.01  # share of the logarithmic range of a parameter, next to either bound, that counts as its bound

LogPrior = Callable[[Kernel, Float[Array, ""]], Float[Array, ""]]
"""Log density of a prior over a kernel and a noise variance, up to a constant."""


def log_normal_prior(
    kernel: Kernel,
    noise_variance: Float[Array, ""],
    spread: Float[Array, ""] | float,
    noise_spread_below: float | None = None,
) -> LogPrior:
    """Independent log-normal priors of a kernel's hyper-parameters and of a noise variance.

    Args:
        kernel: Medians of the kernel's hyper-parameters.
        noise_variance: Median of the noise variance.
        spread: Standard deviation of the logarithms.
        noise_spread_below: The same for a noise variance below its median, if it differs: a large one lets
            the noise vanish.
    """
    medians = jax.tree.leaves((kernel, noise_variance))

    def log_prior(kernel: Kernel, noise_variance: Float[Array, ""]) -> Float[Array, ""]:
        found = jax.tree.leaves((kernel, noise_variance))
        scores = [jnp.log(a / b) / spread for a, b in zip(found, medians, strict=True)]
        if noise_spread_below is not None:
            scores[-1] = jnp.where(scores[-1] < 0.0, scores[-1] * (spread / noise_spread_below), scores[-1])
        return sum((-0.5 * jnp.sum(score**2) for score in scores), jnp.zeros_like(noise_variance))

    return log_prior


class Optimum(eqx.Module):
    """The best result over all starting points.

    Attributes:
        params: Hyper-parameters, in the structure of the given ones.
        value: Value of the objective. If no starting point had a finite value, it is minus infinity, and
            `params` are the first starting point.
        has_converged: Whether the gradient nearly vanishes at the optimum, and no parameter is at a bound.
        is_at_bound: Whether each parameter is at a bound, in the structure of `params`: a better value may
            lie beyond.
    """

    params: PyTree
    value: Float[Array, ""]
    has_converged: Bool[Array, ""]
    is_at_bound: PyTree

    @property
    def is_finite(self) -> Bool[Array, "*batch"]:
        """Whether any starting point had a finite value."""
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
    """Maximise an objective over positive parameters.

    By L-BFGS. A step is accepted only if the objective rises: a search that meets NaN stops at its previous
    point, and a search that starts at NaN is never chosen.

    Args:
        objective: A log evidence, plus a log prior density if there is one.
        params: The first starting point: a tree whose floating-point leaves, all positive, are varied.
        key: Random key of the other starting points.
        num_starts: Number of starting points.
        num_steps: Maximum number of steps from each starting point.
        spread: Standard deviation of the logarithms of the other starting points around the first.
        bounds: Lower and upper bound of every parameter; starting points are moved inside.

    Raises:
        ValueError: A number of starting points or steps is below 1, or the bounds are not positive, finite
            and in order.
    """
    check_count("num_starts", num_starts, 1)
    check_count("num_steps", num_steps, 1)
    if not 0.0 < bounds[0] < bounds[1] < math.inf:
        raise ValueError(f"bounds: got {bounds[0]:g} and {bounds[1]:g}; allowed: 0 < low < high, finite")
    varied, fixed = eqx.partition(params, eqx.is_inexact_array)
    first, unravel = ravel_pytree(varied)
    low, high = (jnp.log(jnp.asarray(bound, first.dtype)) for bound in bounds)

    # Unbounded variables: a sigmoid of a variable gives the logarithm of its parameter, within the bounds.
    def params_at(point: Float[Array, "P"]) -> PyTree:
        return eqx.combine(unravel(jnp.exp(low + (high - low) * jax.nn.sigmoid(point))), fixed)

    @jax.jit  # traced once for the first step, the line searches and their gradients
    def loss(point: Float[Array, "P"]) -> Float[Array, ""]:
        return -objective(params_at(point))

    def search(point: Float[Array, "P"]) -> _Iterate:
        value, gradient = jax.value_and_grad(loss)(point)
        iterate = _Iterate(point, value, gradient)
        is_active = jnp.isfinite(value) & ~iterate.is_stationary()
        carry = iterate, solver.init(point), jnp.zeros((), jnp.int32), is_active
        carry = batched_together(carry)
        return jax.lax.while_loop(lambda carry: carry[3] & (carry[2] < num_steps), step, carry)[0]

    def step(carry):
        iterate, state, number, is_active = carry
        # In a batch, finished searches step on with the others. A gradient of 0 ends their line search at
        # once; otherwise it would run to its limit, and the active searches would wait.
        gradient = jnp.where(is_active, iterate.gradient, 0.0)
        with jax.numpy_dtype_promotion("standard"):  # optax adds integers of two widths
            updates, state = solver.update(
                gradient, state, iterate.point, value=iterate.value, grad=gradient, value_fn=loss
            )
        value, gradient = (optax.tree_utils.tree_get(state, name) for name in ("value", "grad"))
        new = _Iterate(iterate.point + updates, value, gradient)
        # L-BFGS with a failed line search may return a worse point or NaN: the search keeps its point and
        # ends.
        is_better = is_active & new.is_finite() & (value < iterate.value)
        iterate = optax.tree.where(is_better, new, iterate)
        return iterate, state, number + 1, is_better & ~iterate.is_stationary()

    solver = optax.lbfgs()
    # The first start is the given point itself. Starts keep off the ends, where the sigmoid has no gradient.
    away = jax.random.normal(key, (num_starts, first.shape[0]), first.dtype).at[0].set(0.0)
    share = (jnp.log(first)[None, :] + spread * away - low) / (high - low)
    starts = jax.scipy.special.logit(jnp.clip(share, EDGE, 1.0 - EDGE))
    results = jax.vmap(search)(starts)
    # NaN must not win: argmin would return its index.
    values = jnp.where(jnp.isfinite(results.value), results.value, jnp.inf)
    best = jax.tree.map(lambda leaf: leaf[jnp.argmin(values)], results)
    is_finite = jnp.isfinite(best.value)
    found = params_at(best.point)
    # A start that was moved to the edge and stays there is at the bound, whatever its rounding.
    at_bound = jnp.abs(jax.nn.sigmoid(best.point) - 0.5) >= 0.5 - 1.01 * EDGE
    return Optimum(
        params=jax.tree.map(lambda new, old: jnp.where(is_finite, new, old), found, params),
        value=-jnp.min(values),
        has_converged=is_finite & best.is_stationary() & ~jnp.any(at_bound),
        is_at_bound=jax.tree.map(lambda leaf: leaf > 0.5, unravel(at_bound.astype(first.dtype))),
    )


class _Iterate(eqx.Module):
    """A point of a search, its loss, and the gradient of the loss."""

    point: Float[Array, "P"]
    value: Float[Array, ""]
    gradient: Float[Array, "P"]

    def is_finite(self) -> Bool[Array, ""]:
        return jnp.isfinite(self.value) & jnp.all(jnp.isfinite(self.gradient))

    def is_stationary(self) -> Bool[Array, ""]:
        # The conditioning of the evidence limits the accuracy of its gradient to far above machine epsilon.
        tolerance = float(jnp.finfo(self.value.dtype).eps) ** 0.25 * (1.0 + jnp.abs(self.value))
        return jnp.max(jnp.abs(self.gradient)) <= tolerance


@compiled_if_known
def relearn(
    gp: GaussianProcess,
    key: Key[Array, ""],
    *,
    learn_noise: bool = True,
    learn_mean: bool = False,
    log_prior: LogPrior | None = None,
    noise_variances: Float[Array, "N"] | None = None,
    num_starts: int = 8,
    num_steps: int = 30,
    spread: float = 1.5,
    bounds: tuple[float, float] = (1e-6, 1e6),
) -> tuple[GaussianProcess, Optimum]:
    """Maximise the evidence of a posterior over its hyper-parameters and refit it.

    The present hyper-parameters are the first starting point, and are kept unless better ones are found; so
    without observations nothing changes. A learned noise variance below the floor, see
    `GaussianProcess.noise`, is returned as the floor.

    Args:
        gp: The posterior; all hyper-parameters of its kernel must be positive.
        key: Random key of the other starting points.
        learn_noise: Whether to learn the noise variance.
        learn_mean: Whether to learn a constant prior mean, in place of the mean of the process.
        log_prior: Log prior density of the hyper-parameters, added to the log evidence.
        noise_variances: Known noise variance of each observation, instead of a common one; not learned.
        num_starts: Number of starting points.
        num_steps: Maximum number of steps from each starting point.
        spread: Standard deviation of the logarithms of the other starting points around the first.
        bounds: Lower and upper bound of every hyper-parameter.
    """

    def refit(kernel: Kernel, noise_variance: Float[Array, ""]) -> GaussianProcess:
        # For given hyper-parameters, the best constant mean has a closed form: the search does not vary it.
        fitted = gp.refitted(kernel, noise_variance, noise_variances)
        return fitted.with_constant_mean() if learn_mean else fitted

    def objective(params) -> Float[Array, ""]:
        kernel, noise_variance = params
        noise_variance = gp.noise_variance if noise_variance is None else noise_variance
        return score(refit(kernel, noise_variance))

    def score(gp: GaussianProcess) -> Float[Array, ""]:
        evidence = gp.log_marginal_likelihood()
        return evidence if log_prior is None else evidence + log_prior(gp.kernel, gp.noise_variance)

    is_learned = learn_noise and noise_variances is None
    present = (gp.kernel, gp.noise_variance if is_learned else None)
    optimum = maximise(
        objective, present, key, num_starts=num_starts, num_steps=num_steps, spread=spread, bounds=bounds
    )
    # The negation prefers any finite optimum to a present score of NaN.
    is_better = optimum.is_finite & ~(score(gp) >= optimum.value)
    kernel, noise_variance = jax.tree.map(
        lambda found, given: jnp.where(is_better, found, given), optimum.params, present
    )
    if noise_variance is None:
        return refit(kernel, gp.noise_variance), optimum
    fitted = refit(kernel, noise_variance)
    # The least that any observation has: with it, the posterior is the same.
    used = jnp.min(jnp.where(gp.is_held(), fitted.noise(gp.x), jnp.inf))
    used = jnp.where(gp.count > 0, used, noise_variance)
    return eqx.tree_at(lambda gp: gp.noise_variance, fitted, used), optimum
