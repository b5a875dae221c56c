"""The inner optimiser of Bayesian optimisation: many quasi-random candidates, then a few gradient steps.

The thesis names DIRECT (Section 2.7); on an accelerator a batch of candidates scored at once costs one
matrix product.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.acquisition.functions import Acquisition
from bojax.models.gaussian_process import GaussianProcess


def best_candidate(
    acquisition: Acquisition,
    posterior: GaussianProcess,
    best: Float[Array, ""],
    candidates: Float[Array, "C D"],
    whitened: Float[Array, "N C"],
) -> Int[Array, ""]:
    """Index of the candidate of highest acquisition, the first of equal ones.

    Args:
        acquisition: What is maximised.
        posterior: The belief about the function.
        best: The highest value observed so far.
        candidates: The points to choose from.
        whitened: `posterior.whiten(candidates)`, which `posterior.next_whitened` keeps up to date.
    """
    mean, variance = posterior.moments(candidates, whitened)
    return jnp.argmax(acquisition(mean, jnp.sqrt(variance), best))


def refine(
    acquisition: Acquisition,
    posterior: GaussianProcess,
    best: Float[Array, ""],
    start: Float[Array, "D"],
    num_steps: int,
    step_size: float = 0.1,
) -> Float[Array, "D"]:
    """A local maximum near `start` in the box [-1, 1]^D, by signed gradient steps that halve on failure.

    A step of `step_size` along the sign of the gradient is kept if the acquisition rises and halved
    otherwise: no scale of the acquisition enters, and the result is never worse than the start.
    """

    def score(x: Float[Array, "D"]) -> Float[Array, ""]:
        mean, variance = posterior.predict(x[None, :])
        # The square root has no gradient at 0; the floor keeps it finite where a point was observed.
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
