"""The world of a problem seen from above: declared by problems, drawn by maps, films and MuJoCo scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass(frozen=True)
class Outline:
    """The shapes of a world, in metres: a box is `(x_min, y_min, x_max, y_max)`, a disc `(x, y, radius)`.

    Attributes:
        border: The domain, as a box; None for a world without a border.
        obstacles: Boxes or discs that stop a path or end an episode.
        goals: Boxes or discs to reach.
        start: Initial position, `(x, y)`; None if it differs between runs.
        heading: Heading to reach in a goal, in radians; None if all are allowed.
        blocks: Boxes that stand on the ground, `(x_min, y_min, x_max, y_max, height)`.
        area: Borders of the polygons that may be driven in, and of their holes, each a list of `(x, y)`;
            empty if there are none.
    """

    border: Sequence[Any] | None = None
    obstacles: Sequence[Sequence[Any]] = ()
    goals: Sequence[Sequence[Any]] = ()
    start: Sequence[Any] | None = None
    heading: Any = None
    blocks: Sequence[Sequence[Any]] = ()
    area: Sequence[Sequence[Sequence[Any]]] = ()

    def as_numbers(self) -> dict[str, Any]:
        """The outline as plain numbers.

        Raises:
            ValueError: A shape has the wrong number of values, or a value is not finite.
        """
        area = [[_numbers(corner, "area", (2,)) for corner in ring] for ring in self.area]
        return {
            **({"area": area} if area else {}),
            "border": None if self.border is None else _numbers(self.border, "border", (4,)),
            "obstacles": [_numbers(shape, "obstacles", (3, 4)) for shape in self.obstacles],
            "goals": [_numbers(shape, "goals", (3, 4)) for shape in self.goals],
            "start": None if self.start is None else _numbers(self.start, "start", (2,)),
            "heading": None if self.heading is None else _numbers([self.heading], "heading", (1,))[0],
            "blocks": [_numbers(shape, "blocks", (5,)) for shape in self.blocks],
        }

    @classmethod
    def of(cls, numbers: Mapping[str, Any]) -> "Outline":
        """The outline with the values of `as_numbers`; omitted values have their defaults."""
        return cls(**{name: value for name, value in numbers.items() if value is not None})


def _numbers(shape: Any, name: str, sizes: tuple[int, ...]) -> list[float]:
    numbers = [float(number) for number in shape]
    if len(numbers) not in sizes or not all(map(isfinite, numbers)):
        allowed = " or ".join(str(size) for size in sizes)
        raise ValueError(f"{name}: got {numbers}; allowed: {allowed} finite numbers")
    return numbers
