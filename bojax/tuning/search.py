"""Search over numeric settings: Bayesian optimisation (Algorithm 1) that proposes batches of points."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.functions import UpperConfidenceBound
from bojax.engine.devices import on_cpu
from bojax.models.kernels import Matern52
from bojax.numerics.quasirandom import shifted_kronecker
from bojax.tuning.ranges import Range

Values = tuple[int | float, ...]
"""A value of each tuned setting."""

LENGTHSCALE, NOISE_VARIANCE = 0.5, 0.1
"""Medians of the priors of the hyper-parameters, for settings in [-1, 1] and standardised scores."""

PRIOR_SPREAD = 0.6
"""Standard deviation of these priors, in the logarithm. With a wide prior, few scores with much noise are
explained as noise alone, and the search stays at the corners of the box."""

KAPPA = 2.0
"""Weight of the standard deviation in the upper confidence bound (2.37), which, unlike expected improvement,
does not depend on the best observed score, the luckiest of noisy ones."""

CANDIDATES, SPARE = 1024, 256
"""Number of points among which a proposal is searched, and of those that stand in for a repeated one."""

BLOCK = 128
"""Number of points at which the posterior is computed together."""

_STREAM = 2**32 - 1
"""Number of the stream of the search below the seed; lower numbers are runs."""


class Search:
    """Proposes points of a space of settings, and learns from their scores; higher scores are better.

    The first batch is quasi-random. Within a later batch, the posterior mean at a proposal is told in the
    place of its score ("kriging believer", Ginsbourger, Le Riche and Carraro, 2010, Section 4.1), so that the
    next proposal goes elsewhere. The real scores replace these values. Lengthscales, one for each setting,
    and the noise variance are relearned after every batch.

    A point is proposed once only: its runs have the same keys and would give the same score. In the place of
    a repeated point, the first new one of a quasi-random sequence is proposed.

    The state depends on the seed and on what was told, in order, and on nothing else. It is computed on the
    CPU, so that it does not depend on the device of the runs.
    """

    def __init__(self, ranges: Sequence[Range], seed: int, batch: int, capacity: int):
        """Start a search that proposes `batch` points together, and learns at most `capacity` scores."""
        self._ranges = tuple(ranges)
        self._seen: set[Values] = set()
        with on_cpu():
            low, high = np.asarray([each.box for each in ranges], np.float64).T
            self._learner = BayesianOptimisation(
                kernel=Matern52(jnp.full(len(ranges), LENGTHSCALE, jnp.float64)),
                acquisition=UpperConfidenceBound(jnp.asarray(KAPPA, jnp.float64)),
                noise_variance=jnp.asarray(NOISE_VARIANCE, jnp.float64),
                low=jnp.asarray(low),
                high=jnp.asarray(high),
                capacity=capacity + batch,
                num_candidates=CANDIDATES,
                num_initial=batch,
                relearn_every=batch,
                prior_spread=PRIOR_SPREAD,
            )
            self._believer = dataclasses.replace(self._learner, relearn_every=0)
            self._key = jax.random.fold_in(jax.random.key(seed), _STREAM)
            self._state = self._learner.init(jax.random.fold_in(self._key, 0))

    def propose(self, number: int) -> list[Values]:
        """New points, at most `number`; fewer if no other values are left."""
        proposals: list[Values] = []
        state = self._state
        with on_cpu():
            for _ in range(number):
                values = self._values(np.asarray(self._believer.ask(state)))
                if values in self._seen or values in proposals:
                    fresh = self._fresh(int(state.num_told), {*self._seen, *proposals})
                    if fresh is None:
                        break
                    values = fresh
                proposals.append(values)
                point = self._point(values)
                mean, _ = _predict(self._believer, state, point[None, :])
                state = self._believer.tell(state, point, mean[0])
        return proposals

    def tell(self, points: Sequence[Values], scores: Sequence[int | float]) -> None:
        """Learn the scores of points; a score that is not finite only says that the point was tried."""
        with on_cpu():
            for values, score in zip(points, scores, strict=True):
                self._state = self._learner.tell(self._state, self._point(values), float(score))
        self._seen.update(points)

    def predict(self, points: Sequence[Values]) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
        """Posterior mean and standard deviation of the score without noise."""
        positions = np.asarray([self._position(values) for values in points])
        parts = []
        with on_cpu():
            for first in range(0, len(points), BLOCK):  # of one size, so that one program serves all
                rows = np.resize(positions[first : first + BLOCK], (BLOCK, positions.shape[1]))
                parts.append(np.stack(_predict(self._learner, self._state, jnp.asarray(rows))))
        mean, std = np.concatenate(parts, axis=1)[:, : len(points)]
        return mean, std

    @property
    def noise_std(self) -> float:
        """Learned standard deviation of the noise of a score."""
        return float(self._learner.noise_std(self._state))

    def _values(self, point: Float[np.ndarray, "D"]) -> Values:
        return tuple(each.value(float(x)) for each, x in zip(self._ranges, point, strict=True))

    def _position(self, values: Values) -> list[float]:
        return [each.position(value) for each, value in zip(self._ranges, values, strict=True)]

    def _point(self, values: Values) -> Float[jax.Array, "D"]:
        return jnp.asarray(self._position(values), jnp.float64)

    def _fresh(self, index: int, tried: set[Values]) -> Values | None:
        """A point that was not tried; None if none of a quasi-random sequence is."""
        key = jax.random.fold_in(self._key, index + 1)
        units = np.asarray(shifted_kronecker(key, SPARE, len(self._ranges), jnp.float64))
        low, high = np.asarray(self._learner.low), np.asarray(self._learner.high)
        for unit in units:
            values = self._values(low + 0.5 * (unit + 1.0) * (high - low))
            if values not in tried:
                return values
        return None


# Compiled once for all searches of a size.
_predict = eqx.filter_jit(BayesianOptimisation.predict)
