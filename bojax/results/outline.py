"""What stands in the world of a problem, seen from above: written into the manifest, drawn by figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Outline:
    """The shapes of a world, in metres. Four numbers are a box, three are a disc.

    Attributes:
        border: The domain, `(x_min, y_min, x_max, y_max)`.
        obstacles: What ends or stops a path: boxes, or discs `(x, y, radius)`.
        goals: Areas to reach, likewise.
    """

    border: Any = None
    obstacles: Sequence[Any] = ()
    goals: Sequence[Any] = ()

    def as_numbers(self) -> dict[str, Any]:
        """The outline as plain numbers.

        Raises:
            ValueError: A shape is neither a box nor a disc of finite numbers.
        """
        border = None if self.border is None else _numbers(self.border, "border", (4,))
        return {
            "border": border,
            "obstacles": [_numbers(shape, "obstacles", (3, 4)) for shape in self.obstacles],
            "goals": [_numbers(shape, "goals", (3, 4)) for shape in self.goals],
        }


def _numbers(shape: Any, name: str, sizes: tuple[int, ...]) -> list[float]:
    numbers = [float(np.asarray(number)) for number in shape]
    if len(numbers) not in sizes or not np.isfinite(numbers).all():
        allowed = " or ".join(str(size) for size in sizes)
        raise ValueError(f"{name}: got {numbers}; allowed: {allowed} finite numbers")
    return numbers
