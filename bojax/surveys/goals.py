"""Goals of a survey: how much the error at each place counts."""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from bojax.surveys.area import Area

HIGHEST = 0.1
"""Share of the area that hot spots are expected to cover."""

CONFIDENCE = 1.96
"""Standard deviations around the mean in which a straddle looks for a threshold, as in its source."""

ALLOWED = "map, hotspots, threshold=V or region=FILE"
Kind = Literal["map", "hotspots", "threshold", "region"]


@dataclass(frozen=True, eq=False)
class Goal:
    """What a survey is for.

    The error that a survey leaves is a weighted mean over the area. The weights are computed from the belief
    about the field before the route:

    - `map`: all places count alike.
    - `hotspots`: the probability that the field exceeds a level, at which these probabilities have a mean of
      `HIGHEST`.
    - `threshold`: the straddle of Bryan et al. (2005), 1.96 s - |m - threshold| with the mean m and the
      standard deviation s, or 0 where it is negative.
    - `region`: only places in a region count.

    Attributes:
        kind: One of these names.
        threshold: Value to find, in the units of the field; NaN without one.
        region: Part of the area that counts; None for the whole area.
    """

    kind: Kind = "map"
    threshold: float = math.nan
    region: "Area | None" = None

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


def parse_goal(text: str) -> tuple[Kind, str]:
    """The kind of a goal, and the value or the file after its `=`.

    Raises:
        ValueError: The text is not a goal. The message is one line.
    """
    found = re.fullmatch(r"(map|hotspots)|(threshold|region)=(.+)", text)
    if not found:
        raise ValueError(f"got {text}; allowed: {ALLOWED}")
    kind, argument = found[1] or found[2], found[3] or ""
    if kind == "threshold":
        try:
            is_finite = math.isfinite(float(argument))
        except ValueError:
            is_finite = False
        if not is_finite:
            raise ValueError(f"got {text}; allowed: threshold=V, where V is a number")
    return kind, argument  # pyright: ignore[reportReturnType]


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
