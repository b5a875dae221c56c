"""Checks of the budget of a field problem, in metres or in seconds at a speed."""

from typing import Any

ROUNDING = 1e-9  # share of a distance


def distance_of(budget: Any, time_budget: Any, speed: Any) -> Any:
    """The distance that may be driven, m: numbers or arrays; None without a budget."""
    return budget if time_budget is None or speed is None else time_budget * speed


def check_one_budget(
    budget: float | None, time_budget: float | None, speed: float | None, has_end: bool
) -> None:
    """Refuse two budgets, half a budget of time, or an end point without one, or raise ValueError."""
    if budget is not None and time_budget is not None:
        raise ValueError("time_budget: not with budget; allowed: one of the two")
    if (time_budget is None) != (speed is None):
        lacks = "speed" if speed is None else "time_budget"
        raise ValueError(f"{lacks}: got null; allowed: a number, since time_budget and speed go together")
    if has_end and budget is None and time_budget is None:
        raise ValueError("end: needs a budget, or time_budget and speed")


def check_reach(distance: float, least: float, speed: float | None, has_start: bool) -> None:
    """Refuse a budget below the distance from the start to the end point, or raise ValueError.

    Args:
        distance: The budget, m.
        least: The distance from the start, or the largest from anywhere, m.
        speed: Speed of a budget of time, m/s.
        has_start: Whether the start is known.
    """
    if distance < least * (1.0 - ROUNDING):
        name, factor, unit = ("budget", 1.0, "m") if speed is None else ("time_budget", speed, "s")
        start = "the start" if has_start else "any start"
        raise ValueError(
            f"{name}: got {distance / factor:g}; allowed: >= {least / factor:.4g} {unit}, to get from "
            f"{start} to the end point"
        )


def check_steps(distance: float, max_steps: int, length: float, name: str) -> None:
    """Refuse paths that are so short that an episode may end before its end point, or raise ValueError.

    Args:
        distance: The budget, m.
        max_steps: Number of paths.
        length: Length of a path, m.
        name: Setting of the length.
    """
    if length * max_steps < distance * (1.0 - ROUNDING):
        raise ValueError(
            f"{name}: got {length:g}; allowed: >= {distance / max_steps:.4g}, so that problem.max_steps "
            f"({max_steps}) paths are as long as the budget ({distance:g} m) and reach the end point"
        )
