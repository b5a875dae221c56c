"""Search over a space: Bayesian optimisation (Algorithm 1) that proposes batches of points."""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.functions import LogExpectedImprovement, UpperConfidenceBound
from bojax.engine.devices import on_cpu
from bojax.numerics.quasirandom import shifted_kronecker
from bojax.optimisation.kernel import mixed_matern52
from bojax.optimisation.space import Axis

Values = tuple[Any, ...]
"""A value of each axis."""

LENGTHSCALE = 0.5
"""Median of the prior of the lengthscales, in units of half a range."""

KAPPA = 2.0
"""Weight of the standard deviation in the upper confidence bound (2.37), which, unlike expected improvement,
does not depend on the best observed score, the luckiest of noisy ones."""

CANDIDATES, LOCAL, SPARE = 1024, 512, 256
"""Number of points among which a proposal is searched, of those near the best one, and of those that stand in
for a repeated one."""

STARTS, STEPS = 8, 60
"""Number of candidates that gradient steps improve, and of these steps, where scores have no noise."""

BLOCK = 128
"""Number of points at which the posterior is computed together."""

_STREAM = 2**32 - 1
"""Number of the stream of the search below the seed; lower numbers are runs."""


class Search:
    """Proposes points of a space, and learns from their scores; higher scores are better.

    The first batch is quasi-random. Within a later batch, the posterior mean at a proposal is told in the
    place of its score ("kriging believer", Ginsbourger, Le Riche and Carraro, 2010, Section 4.1), so that the
    next proposal goes elsewhere. The real scores replace these values. Lengthscales, one for each axis, and
    the noise variance are relearned after every batch.

    A point is proposed once only: the same point would have the same score. In the place of a repeated point,
    the first new one of a quasi-random sequence is proposed, or else the first new one of all points.

    The state depends on the seed and on what was told, in order, and on nothing else. It is computed on the
    CPU in float64, so that it does not depend on the device of the runs.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        seed: int,
        batch: int,
        capacity: int,
        *,
        is_noisy: bool = True,
        initial: int | None = None,
    ):
        """Start a search that proposes `batch` points together, and learns at most `capacity` scores.

        Args:
            axes: The axes of the space.
            seed: Seed of the search.
            batch: Largest number of points that are proposed together.
            capacity: Largest number of scores.
            is_noisy: Whether scores of one point differ from time to time. Proposals then maximise the upper
                confidence bound, and otherwise the logarithm of the expected improvement.
            initial: Number of quasi-random points in the beginning; by default, one batch.
        """
        self._axes = tuple(axes)
        self._seen: set[Values] = set()
        with _in_float64():
            boxes = [each.box for each in axes for _ in range(each.width)]
            low, high = np.asarray(boxes, np.float64).T
            self._learner = BayesianOptimisation(
                kernel=mixed_matern52(jnp.full(len(self._axes), LENGTHSCALE, jnp.float64), self._axes),
                low=jnp.asarray(low),
                high=jnp.asarray(high),
                capacity=capacity + batch,
                num_candidates=CANDIDATES,
                num_initial=batch if initial is None else initial,
                relearn_every=1,
                **(_noisy() if is_noisy else _exact()),
            )
            self._believer = dataclasses.replace(self._learner, relearn_every=0)
            self._key = jax.random.fold_in(jax.random.key(seed), _STREAM)
            self._state = self._learner.init(jax.random.fold_in(self._key, 0))

    def propose(self, number: int) -> list[Values]:
        """New points, at most `number`; fewer if no other values are left."""
        proposals: list[Values] = []
        state = self._state
        with _in_float64():
            for _ in range(number):
                values = self._values(np.asarray(self._believer.ask(state)))
                if values in self._seen or values in proposals:
                    fresh = self._fresh(int(state.num_told), {*self._seen, *proposals})
                    if fresh is None:
                        break
                    values = fresh
                proposals.append(values)
                if len(proposals) < number:
                    point = self._point(values)
                    mean, _ = _predict(self._believer, state, point[None, :])
                    state = self._believer.tell(state, point, mean[0])
        return proposals

    def tell(self, points: Sequence[Values], scores: Sequence[int | float]) -> None:
        """Learn the scores of points; a score that is not finite only says that the point was tried."""
        with _in_float64():
            for index, (values, score) in enumerate(zip(points, scores, strict=True)):
                learner = self._learner if index == len(points) - 1 else self._believer
                self._state = learner.tell(self._state, self._point(values), float(score))
        self._seen.update(points)

    def predict(self, points: Sequence[Values]) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
        """Posterior mean and standard deviation of the score without noise."""
        positions = np.asarray([self._position(values) for values in points])
        parts = []
        with _in_float64():
            for first in range(0, len(points), BLOCK):  # of one size, so that one program serves all
                rows = np.resize(positions[first : first + BLOCK], (BLOCK, positions.shape[1]))
                parts.append(np.stack(_predict(self._learner, self._state, jnp.asarray(rows))))
        mean, std = np.concatenate(parts, axis=1)[:, : len(points)]
        return mean, std

    @property
    def noise_std(self) -> float:
        """Learned standard deviation of the noise of a score."""
        with _in_float64():
            return float(self._learner.noise_std(self._state))

    def _values(self, point: Float[np.ndarray, "D"]) -> Values:
        values, first = [], 0
        for each in self._axes:
            values.append(each.value([float(x) for x in point[first : first + each.width]]))
            first += each.width
        return tuple(values)

    def _position(self, values: Values) -> list[float]:
        return [x for each, value in zip(self._axes, values, strict=True) for x in each.position(value)]

    def _point(self, values: Values) -> Float[jax.Array, "D"]:
        return jnp.asarray(self._position(values), jnp.float64)

    def _fresh(self, index: int, tried: set[Values]) -> Values | None:
        """A point that was not tried; None if there is none."""
        key = jax.random.fold_in(self._key, index + 1)
        low, high = np.asarray(self._learner.low), np.asarray(self._learner.high)
        units = np.asarray(shifted_kronecker(key, SPARE, len(low), jnp.float64))
        for unit in units:
            values = self._values(low + 0.5 * (unit + 1.0) * (high - low))
            if values not in tried:
                return values
        # Most of the space was tried, so that it has few points: integers and choices.
        sets = [each.all_values() for each in self._axes]
        every = itertools.product(*sets) if all(sets) else ()
        return next((values for values in every if values not in tried), None)


def _noisy() -> dict:
    return {
        "acquisition": UpperConfidenceBound(jnp.asarray(KAPPA, jnp.float64)),
        "noise_variance": jnp.asarray(0.1, jnp.float64),
        # With a wide prior, few scores with much noise are explained as noise alone, and the search stays at
        # the corners of the box.
        "prior_spread": 0.6,
    }


def _exact() -> dict:
    return {
        "acquisition": LogExpectedImprovement(jnp.zeros((), jnp.float64)),
        "noise_variance": jnp.asarray(1e-6, jnp.float64),
        "prior_spread": 1.0,
        "num_local": LOCAL,
        "num_starts": STARTS,
        "refine_steps": STEPS,
    }


@contextmanager
def _in_float64() -> Iterator[None]:
    with on_cpu(), jax.enable_x64(True):
        yield


# Compiled once for all searches of a size.
_predict = eqx.filter_jit(BayesianOptimisation.predict)
