"""Checks of the numbers that a user gives a mission."""

from typing import Any

import numpy as np

from bojax.surveys.polylines import Waypoints


def above_zero(name: str, given: Any, unit: str = "") -> float:
    """A number above 0.

    Raises:
        ValueError: It is something else.
    """
    try:
        value = np.nan if isinstance(given, str) else float(given)
    except (TypeError, ValueError):
        value = np.nan
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name}: got {given}; allowed: a number > 0{unit and f', {unit}'}")
    return value


def numbers(name: str, given: Any, allowed: str = "numbers") -> np.ndarray:
    """An array of numbers, NaN where a mask of NumPy is set.

    Raises:
        ValueError: It holds text, integers beyond float64, or rows of different lengths.
    """
    try:
        return np.ma.filled(np.ma.asarray(given, float), np.nan)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: not an array of numbers; allowed: {allowed}") from error


def rows(name: str, given: Any) -> Waypoints:
    """Rows of x and y, or nothing.

    Raises:
        ValueError: They have another form.
    """
    found = numbers(name, given, "[[x, y], ...], m")
    if found.size and (found.ndim != 2 or found.shape[1] != 2):
        raise ValueError(f"{name}: got the shape {found.shape}; allowed: (N, 2), rows of x and y, m")
    return found.reshape(-1, 2)


def positions(name: str, given: Any, robots: int) -> list[Waypoints]:
    """A position for each robot, of one for all or one for each; further numbers of each are left out.

    Raises:
        ValueError: They are not finite, have another form, or are of another number of robots.
    """
    allowed = "x and y in metres"
    points = np.atleast_2d(numbers(name, given, allowed))[:, :2]
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(f"{name}: got {given}; allowed: {allowed}")
    if len(points) not in (1, robots):
        raise ValueError(f"{name}: got {len(points)} positions; allowed: one, or one for each robot")
    return list(np.broadcast_to(points, (robots, 2)).copy())
