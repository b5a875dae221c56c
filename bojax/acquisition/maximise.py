"""Maximisation of an acquisition function: many quasi-random candidates, then a few gradient steps.

The thesis names DIRECT (Section 2.7). On an accelerator, scoring all candidates at once costs one matrix
product.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.acquisition.functions import Acquisition
from bojax.models.gaussian_process import GaussianProcess

COLUMNS = 16  # number of columns of `first_maximum`: four AVX2 registers of float64


def best_candidate(
    acquisition: Acquisition,
    posterior: GaussianProcess,
    best: Float[Array, ""],
    candidates: Float[Array, "C D"],
    whitened: Float[Array, "N C"],
) -> Int[Array, ""]:
    """Index of the candidate of highest acquisition; the first one if several are tied.

    `best` is the highest observed value, and `whitened` is `posterior.whiten(candidates)`, which
    `posterior.next_whitened` can extend.
    """
    mean, variance = posterior.moments(candidates, whitened)
    return first_maximum(acquisition(mean, jnp.sqrt(variance), best))


def best_refined(
    acquisition: Acquisition,
    posterior: GaussianProcess,
    best: Float[Array, ""],
    candidates: Float[Array, "C D"],
    num_starts: int,
    num_steps: int,
) -> Float[Array, "D"]:
    """The best of the local maxima near the `num_starts` candidates of highest acquisition."""

    def scores(xs: Float[Array, "M D"]) -> Float[Array, "M"]:
        mean, variance = posterior.predict(xs)
        return acquisition(mean, jnp.sqrt(variance), best)

    _, starts = jax.lax.top_k(scores(candidates), num_starts)
    refined = jax.vmap(lambda start: refine(acquisition, posterior, best, start, num_steps))(
        candidates[starts]
    )
    return refined[jnp.argmax(scores(refined))]


def first_maximum(scores: Float[Array, "C"]) -> Int[Array, ""]:
    """The result of `jnp.argmax`: the index of the first maximum, or of a NaN if there is one."""
    # On a CPU, the maxima of `COLUMNS` columns are found first, in vectorised arithmetic. `argmax` compares,
    # and so computes, one score after the other: for 128 candidates of 20 observations, it takes three times
    # as long.
    number = scores.shape[0]
    if number % COLUMNS or jax.default_backend() != "cpu":
        return jnp.argmax(scores)
    columns = scores.reshape(-1, COLUMNS)
    largest, row = jnp.max(columns, axis=0), jnp.argmax(columns, axis=0)
    index = COLUMNS * row + jnp.arange(COLUMNS, dtype=row.dtype)
    is_first = (largest == jnp.max(largest)) | jnp.isnan(largest)
    return jnp.min(jnp.where(is_first, index, number))


def refine(
    acquisition: Acquisition,
    posterior: GaussianProcess,
    best: Float[Array, ""],
    start: Float[Array, "D"],
    num_steps: int,
    step_size: float = 0.1,
) -> Float[Array, "D"]:
    """A local maximum near `start` in the box [-1, 1]^D, by steps along the sign of the gradient.

    A step is accepted if the acquisition rises; otherwise the step size is halved. The result does not depend
    on the scale of the acquisition and is never worse than the start.
    """

    def score(x: Float[Array, "D"]) -> Float[Array, ""]:
        mean, variance = posterior.predict(x[None, :])
        # The gradient of the square root is infinite at 0; the floor keeps it finite at observed points.
        std = jnp.sqrt(jnp.maximum(variance, jnp.finfo(x.dtype).eps))
        return acquisition(mean, std, best)[0]

    def step(carry, _):
        x, value, size = carry
        proposal = jnp.clip(x + size * jnp.sign(jax.grad(score)(x)), -1.0, 1.0)
        proposed = score(proposal)
        is_better = proposed > value
        return (
            jnp.where(is_better, proposal, x),
            jnp.where(is_better, proposed, value),
            jnp.where(is_better, size, 0.5 * size),
        ), None

    size = jnp.asarray(step_size, start.dtype)
    (x, _, _), _ = jax.lax.scan(step, (start, score(start), size), length=num_steps)
    return x
