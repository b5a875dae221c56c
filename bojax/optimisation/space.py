"""Spaces to search: ranges of numbers and integers, linear or logarithmic, and choices. Imports no JAX."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, TypeAlias

import numpy as np

from bojax.config.errors import shown

NUM_SLICE = 101
"""Number of values along a range at which a slice through a model is computed."""

SIGNIFICANT = 6
"""Significant digits of a proposed number, so that proposals stay readable."""

INTEGER_LIMIT = 2**53
"""The magnitude below which float64 represents every integer."""

VALUE = "value"
"""The column of values in a table of evaluations, the others being those of the axes."""

LOG = "log"
"""The third element of a range whose values are searched on a logarithmic scale."""


class SpaceError(ValueError):
    """A space, or a value of it, is wrong; the message is one line."""


@dataclass(frozen=True)
class Range:
    """A number that a search varies."""

    key: str
    low: float
    high: float
    is_log: bool  # whether values are searched on a logarithmic scale
    is_integer: bool  # whether values are integers; positions are then rounded

    @property
    def width(self) -> int:
        """Number of coordinates of a position."""
        return 1

    @property
    def box(self) -> tuple[float, float]:
        """The bounds of the position; those of an integer include all that is rounded to it."""
        spare = 0.5 if self.is_integer else 0.0
        return self._coordinate(self.low - spare), self._coordinate(self.high + spare)

    def position(self, value: Any) -> list[float]:
        """Map a value to its position."""
        return [self._coordinate(value)]

    def value(self, position: Sequence[float]) -> int | float:
        """Map a position to a value, rounded and clipped to the bounds."""
        value = 10.0 ** position[0] if self.is_log else position[0]
        if self.is_integer:
            return int(min(max(math.floor(value + 0.5), self.low), self.high))
        return float(min(max(self._readable(value), self.low), self.high))

    def all_values(self) -> Sequence[int]:
        """All integers, in order; none of real numbers."""
        return range(int(self.low), int(self.high) + 1) if self.is_integer else []

    def checked(self, value: Any) -> int | float:
        """A value that a user gives.

        Raises:
            SpaceError: It is not a number of the range.
        """
        number = _number_of(value)
        is_inside = number is not None and self.low <= number <= self.high
        if number is None or not is_inside or (self.is_integer and number != int(number)):
            kind = "an integer" if self.is_integer else "a number"
            raise SpaceError(
                f"{self.key}: got {shown(value)}; allowed: {kind} from {self.low:g} to {self.high:g}"
            )
        return int(number) if self.is_integer else number

    def _coordinate(self, value: float) -> float:
        return math.log10(value) if self.is_log else float(value)

    def _readable(self, value: float) -> float:
        """A number of few digits; of a range that is narrow beside its bounds, digits of its width."""
        largest = max(abs(self.low), abs(self.high))
        spare = max(0, math.floor(math.log10(largest / (self.high - self.low))))
        return float(f"{value:.{SIGNIFICANT + spare}g}")


@dataclass(frozen=True)
class Choice:
    """One of some values without an order, whose position has a coordinate for each: the largest one wins."""

    key: str
    values: tuple[Hashable, ...]

    @property
    def width(self) -> int:
        """Number of coordinates of a position."""
        return len(self.values)

    @property
    def box(self) -> tuple[float, float]:
        """The bounds of each coordinate."""
        return -1.0, 1.0

    def position(self, value: Any) -> list[float]:
        """Map a value to its position."""
        chosen = self.values.index(value)
        return [1.0 if index == chosen else -1.0 for index in range(len(self.values))]

    def value(self, position: Sequence[float]) -> Hashable:
        """Map a position to a value."""
        return self.values[max(range(len(self.values)), key=lambda index: position[index])]

    def all_values(self) -> Sequence[Hashable]:
        """All choices."""
        return self.values

    def checked(self, value: Any) -> Hashable:
        """A value that a user gives.

        Raises:
            SpaceError: It is none of the choices.
        """
        for each in self.values:
            if type(each) is type(value) and each == value:
                return each
        raise SpaceError(f"{self.key}: got {shown(value)}; allowed: {', '.join(map(shown, self.values))}")


Axis: TypeAlias = Range | Choice


def checked_point(axes: Sequence[Axis], point: Any) -> dict[str, Any]:
    """A point that a user gives: a value for each axis.

    Raises:
        SpaceError: A name is missing or unknown, or a value is not one of its axis.
    """
    names = [axis.key for axis in axes]
    if not isinstance(point, Mapping) or set(point) != set(names):
        raise SpaceError(f"point: got {shown(point)}; allowed: a value for each of {', '.join(names)}")
    return {axis.key: axis.checked(point[axis.key]) for axis in axes}


def slice_along(axis: Axis) -> list[Any]:
    """The values of a slice through a model: all choices, or evenly spaced values of a range, in order."""
    if isinstance(axis, Choice):
        return list(axis.values)
    (low,), (high,) = axis.position(axis.low), axis.position(axis.high)
    return sorted({axis.value([position]) for position in np.linspace(low, high, NUM_SLICE).tolist()})


def read_space(space: Mapping[str, Any]) -> tuple[Axis, ...]:
    """The axes of a space.

    Args:
        space: For each name a tuple `(low, high)`, of integers if both bounds are, a tuple `(low, high,
            "log")`, or a list of choices.

    Raises:
        SpaceError: A bound or a choice is wrong.
    """
    if not isinstance(space, Mapping) or not space:
        raise SpaceError(
            f"space: got {shown(space)}; allowed: a mapping of names to ranges or choices, such as "
            '{"rate": (1e-4, 1.0, "log"), "depth": (1, 8), "kernel": ["rbf", "matern"]}'
        )
    return tuple(_axis(name, given) for name, given in space.items())


def _axis(name: Any, given: Any) -> Axis:
    if not isinstance(name, str) or name == VALUE:
        raise SpaceError(f"space: got the name {shown(name)}; allowed: any other text")
    if isinstance(given, list):
        return _choice(name, given)
    wrong = SpaceError(
        f'{name}: got {given!r:.60}; allowed: a tuple (low, high) or (low, high, "log"), or a list of choices'
    )
    if not isinstance(given, tuple) or len(given) not in (2, 3) or (len(given) == 3 and given[2] != LOG):
        raise wrong
    low, high, is_log = _number_of(given[0]), _number_of(given[1]), len(given) == 3
    if low is None or high is None:
        raise wrong
    if not (math.isfinite(low) and math.isfinite(high) and low < high and math.isfinite(high - low)):
        raise SpaceError(f"{name}: got {low:g} and {high:g}; allowed: low < high, both finite")
    if is_log and low <= 0:
        raise SpaceError(f"{name}: got {low:g}; allowed: > 0, for the logarithm")
    are_integers = isinstance(given[0], Integral) and isinstance(given[1], Integral)
    if are_integers and max(abs(low), abs(high)) >= INTEGER_LIMIT:
        raise SpaceError(f"{name}: got {given!r:.60}; allowed: integers below 2^53 in magnitude")
    number = int if are_integers else float
    return Range(name, number(low), number(high), is_log, are_integers)


def _choice(name: str, given: list[Any]) -> Choice:
    if len(given) < 2:
        raise SpaceError(f"{name}: got {shown(given)}; allowed: at least two choices")
    for each in given:
        if not isinstance(each, Hashable) or (isinstance(each, float) and math.isnan(each)):
            raise SpaceError(f"{name}: got {shown(each)}; allowed: choices such as texts and numbers")
    if len(set(given)) < len(given):
        raise SpaceError(f"{name}: got {shown(given)}; allowed: choices that differ, unlike 1 and True")
    return Choice(name, tuple(given))


def _number_of(value: Any) -> float | None:
    """A number, also one of NumPy; None for anything else."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return None
    try:
        return float(value)
    except OverflowError:  # an integer beyond the floats, outside of every range
        return math.inf
