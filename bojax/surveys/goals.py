"""Goals of a survey: how much the error at each place counts, and what a route leaves undone."""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from bojax.areas.area import Area

HIGHEST = 0.1
"""Share of the area that hot spots are expected to cover."""

CONFIDENCE = 1.96
"""Standard deviations around the mean in which a straddle looks for a threshold, as in its source."""

_NODES, _NODE_WEIGHTS = (each / 2.0 for each in np.polynomial.legendre.leggauss(8))
_NODES = _NODES + 0.5  # on [0, 1]

ALLOWED = "map, hotspots, threshold=V or region=FILE"
_OF_MISSIONS = "map, hotspots, threshold=V or an Area"
Kind = Literal["map", "hotspots", "threshold", "region"]


@dataclass(frozen=True, eq=False)
class Goal:
    """What a survey is for.

    The error that a survey leaves is a weighted mean over the area; a mission, which learns values on the
    way, has a `loss`. The weights are computed from the belief about the field before the route:

    - `map`: all places count alike.
    - `hotspots`: the probability that the field exceeds a level, at which these probabilities have a mean of
      `HIGHEST`.
    - `threshold`: the straddle of Bryan et al. (2005), 1.96 s - |m - threshold| with the mean m and the
      standard deviation s, or 0 where it is negative.
    - `region`: only places in a region count.
    """

    kind: Kind = "map"  # one of these names
    threshold: float = math.nan  # value to find, in the units of the field; NaN without one
    region: "Area | None" = None  # part of the area that counts; None for the whole area

    @property
    def needs_values(self) -> bool:
        """Whether the weights depend on what is known about the values of the field."""
        return self.kind in ("hotspots", "threshold")

    @property
    def meaning(self) -> str:
        """What the error is a mean over, for reports."""
        if self.kind == "hotspots":
            return f"over the area (weighted by the probability of being in its highest {HIGHEST:.0%})"
        if self.kind == "threshold":
            return f"over the area (weighted by the straddle of {self.threshold:g})"
        return "over the region" if self.kind == "region" else "over the area"

    def weights(self, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
        """Weights `[M]` of places with these means and standard deviations of the field.

        They are even where the belief tells no places apart, or no place can reach the threshold.
        """
        if self.kind == "hotspots":
            weights = _probability_above(_level(mean, deviation), mean, deviation)
        elif self.kind == "threshold":
            weights = np.maximum(CONFIDENCE * deviation - np.abs(mean - self.threshold), 0.0)
        else:
            weights = np.ones(len(mean))
        return weights if weights.max() > 0.0 else np.ones(len(mean))

    def loss(
        self, mean: np.ndarray, variance: np.ndarray, explained: np.ndarray, highest: float | None = None
    ) -> np.ndarray:
        """What samples are expected to leave undone, for each of `R` sets of them.

        Before the samples, the mean m' that they will leave at a place is normal: around the mean m of now,
        with the variance that they explain.

        - `hotspots`: minus the root mean squared improvement over the highest mean, E[max(m' - max m, 0)^2]
          at each place (Schonlau, Welch and Jones 1998, with g = 2). Where all means are alike it falls with
          the variance that is explained, as for a map.
        - `threshold`: the expected share of the places with m' on the wrong side of the threshold. With the
          variance v and its explained share sin(a)^2, samples lower the probability of an error by 1/pi times
          the integral over t from 0 to a of exp(-(m - threshold)^2 / (2 v sin(t)^2)).
        - `map`, `region`: the root of the mean variance that is left.

        Args:
            mean: Means `[M]` of places that are spread evenly.
            variance: Variances `[M]` there.
            explained: Reductions `[R, M]` of these variances by each set of samples.
            highest: The mean that hot spots improve on; the highest of these means by default.
        """
        least = np.finfo(float).tiny
        if self.kind == "hotspots":
            moved = np.sqrt(np.maximum(explained, least))
            highest = mean.max() if highest is None else highest
            u = np.maximum((mean - highest) / moved, -40.0)  # below, nothing is gained in float64
            density = np.exp(-0.5 * u**2) / math.sqrt(2.0 * math.pi)
            squared = moved**2 * ((1.0 + u**2) * ndtr(u) + u * density)
            return -np.sqrt(np.maximum(squared, 0.0).mean(axis=-1))
        if self.kind == "threshold":
            ratio = (mean - self.threshold) ** 2 / np.maximum(variance, least)
            share = np.clip(explained / np.maximum(variance, least), 0.0, 1.0)
            angle = np.arcsin(np.sqrt(share))[..., None] * _NODES
            lowered = np.exp(-0.5 * ratio[:, None] / np.maximum(np.sin(angle) ** 2, least))
            gained = np.arcsin(np.sqrt(share)) / math.pi * (lowered @ _NODE_WEIGHTS)
            return (ndtr(-np.sqrt(ratio)) - gained).mean(axis=-1)
        return np.sqrt(np.maximum(variance - explained, 0.0).mean(axis=-1))


def parse_goal(text: str, allowed: str = ALLOWED) -> tuple[Kind, str]:
    """The kind of a goal, and the value or the file after its `=`; a message names what is `allowed`.

    Raises:
        ValueError: The text is not a goal. The message is one line.
    """
    found = re.fullmatch(r"(map|hotspots)|(threshold|region)=(.+)", text)
    if not found:
        raise ValueError(f"got {text}; allowed: {allowed}")
    kind, argument = found[1] or found[2], found[3] or ""
    if kind == "threshold":
        try:
            is_finite = math.isfinite(float(argument))
        except ValueError:
            is_finite = False
        if not is_finite:
            raise ValueError(f"got {text}; allowed: threshold=V, where V is a number")
    return kind, argument  # pyright: ignore[reportReturnType]


def goal_of(given: "str | Area") -> Goal:
    """The goal of a mission: a name, or the part of the area that counts.

    Raises:
        ValueError: The text is not a goal, or names a file.
    """
    if not isinstance(given, str):
        if not hasattr(given, "outline"):
            raise ValueError(f"goal: got {given}; allowed: {_OF_MISSIONS}")
        return Goal("region", region=given)
    try:
        kind, argument = parse_goal(given, _OF_MISSIONS)
    except ValueError as error:
        raise ValueError(f"goal: {error}") from error
    if kind == "region":
        raise ValueError(f"goal: got {given}; allowed: {_OF_MISSIONS}")
    return Goal(kind, float(argument) if argument else math.nan)


def _level(mean: np.ndarray, deviation: np.ndarray) -> float:
    """The level that a share `HIGHEST` of the places is expected to exceed, by bisection."""
    low, high = float((mean - 6.0 * deviation).min()), float((mean + 6.0 * deviation).max())
    for _ in range(60):
        middle = (low + high) / 2.0
        if _probability_above(middle, mean, deviation).mean() > HIGHEST:
            low = middle
        else:
            high = middle
    return (low + high) / 2.0


def _probability_above(level: float, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    return ndtr((mean - level) / np.maximum(deviation, np.finfo(float).tiny))
