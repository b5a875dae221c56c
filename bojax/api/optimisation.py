"""What an optimisation has found: the best point, all evaluations, and figures of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from typing_extensions import override

from bojax.api.results import Picture
from bojax.optimisation.drawing import draw_progress, draw_slice
from bojax.optimisation.search import Search
from bojax.optimisation.space import VALUE, Axis, Range, checked_point, slice_along
from bojax.report import style
from bojax.report.drawing.base import panel_grid


@dataclass(frozen=True)
class Evaluation:
    """A point and its value, which is NaN or infinite if the evaluation failed."""

    point: dict[str, Any]
    value: float

    def is_finite(self) -> bool:
        """Whether the evaluation succeeded."""
        return math.isfinite(self.value)


@dataclass(frozen=True)
class OptimisationResult:
    """The result of `minimise` and `maximise`.

    Attributes:
        evaluations: All evaluations in order, known ones first.
        axes: The axes of the space.
        is_maximised: Whether higher values are better.
        is_noisy: Whether evaluations of one point differ from time to time.
        search: The model; None before any evaluation has succeeded.
    """

    evaluations: tuple[Evaluation, ...]
    axes: tuple[Axis, ...]
    is_maximised: bool
    is_noisy: bool
    search: Search | None

    @override
    def __repr__(self) -> str:
        """The best point and its value: what a notebook shows of a result."""
        number = f"{len(self.evaluations)} evaluations, {self.num_failed} failed"
        return f"OptimisationResult(best={self.best}, value={self.value}, {number})"

    @property
    def best(self) -> dict[str, Any] | None:
        """The point of the best value, with noise of the best mean under the model; None if all failed."""
        return None if self._best is None else self.evaluations[self._best].point

    @property
    def value(self) -> float | None:
        """The value at the best point, with noise its mean under the model; None if all have failed."""
        if self._best is None:
            return None
        if self.is_noisy:
            return float(self.predict([self.evaluations[self._best].point])[0][0])
        return self.evaluations[self._best].value

    @property
    def num_failed(self) -> int:
        """Number of evaluations that failed."""
        return sum(not each.is_finite() for each in self.evaluations)

    @property
    def table(self) -> pa.Table:
        """All evaluations in order: a column for each axis, and `value`."""
        columns = {axis.key: self._column(axis) for axis in self.axes}
        return pa.table({**columns, VALUE: [each.value for each in self.evaluations]})

    def predict(self, points: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the function at points, without noise.

        Raises:
            ValueError: No evaluation has succeeded, `points` is empty or a single point, or a point is not in
                the space.
        """
        if isinstance(points, Mapping):
            raise ValueError("points: got a single point; allowed: a list of points, such as [point]")
        if self.search is None:
            raise ValueError("no evaluation has succeeded")
        checked = [checked_point(self.axes, point) for point in points]
        if not checked:
            raise ValueError("points: got []; allowed: at least one point")
        values = [tuple(point[axis.key] for axis in self.axes) for point in checked]
        mean, std = self.search.predict(values)
        return (mean if self.is_maximised else -mean), std

    def plot(self) -> Picture:
        """A figure of the best value so far, and a slice of the model through the best point along each axis.

        Raises:
            ValueError: No evaluation has succeeded.
        """
        if self.best is None or self.value is None:
            raise ValueError("no evaluation has succeeded")
        told = [each for each in self.evaluations if each.is_finite()]
        values = [each.value for each in told]
        with style.settings():
            figure, grid = panel_grid(1 + len(self.axes), lambda columns: 2.3, 0.4)
            first, *others = grid.flat
            draw_progress(first, [each.value for each in self.evaluations], self.is_maximised)
            first.set_xlabel("evaluation")
            for panel, axis in zip(others, self.axes, strict=False):
                at, chosen = slice_along(axis), self.best[axis.key]
                mean, std = self.predict([{**self.best, axis.key: value} for value in at])
                places = [each.point[axis.key] for each in told]
                draw_slice(
                    panel, axis, (at, mean.tolist(), std.tolist()), (places, values), (chosen, self.value)
                )
            for panel in grid[:, 0]:
                panel.set_ylabel("value")
            png = style.encode(figure)["png"]
        caption = (
            "First panel: each value (dot) and the best one so far (line). Others: mean and 95% interval of "
            "the model along an axis, through the best point (diamond), and all values (dots), whose points "
            "differ in the other axes too."
        )
        alt = f"Best value {self.value:.4g} of {len(self.evaluations)} evaluations."
        return Picture(figure, "Optimisation", caption, alt, png)

    def _column(self, axis: Axis) -> list[Any]:
        """The values of an axis; as text if its choices are not all numbers, all texts, or all Booleans."""
        values = [each.point[axis.key] for each in self.evaluations]
        if isinstance(axis, Range):
            return values
        plain = bool, int | float, str  # a Boolean is an integer, too
        kinds = {next((kind for kind in plain if isinstance(each, kind)), None) for each in axis.values}
        return values if len(kinds) == 1 and None not in kinds else list(map(str, values))

    @cached_property
    def _best(self) -> int | None:
        finite = [index for index, each in enumerate(self.evaluations) if each.is_finite()]
        if not finite:
            return None
        sign = -1.0 if self.is_maximised else 1.0
        values = [self.evaluations[index].value for index in finite]
        if self.is_noisy:
            values = self.predict([self.evaluations[index].point for index in finite])[0].tolist()
        return min(zip((sign * value for value in values), finite, strict=True))[1]
