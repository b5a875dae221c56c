"""What stands around a robot that follows plans: the domain, walls, and the lot to park in, to be drawn."""

from collections.abc import Mapping
from typing import Any

from bojax.robots.models import mujoco

WALL_HEIGHT = 0.1
"""How far walls rise above the highest ground, in metres: no problem says how high they are."""

_UNKNOWN = (-5.0, -5.0, 5.0, 5.0)
_UNTOUCHED = {"contype": 0, "conaffinity": 0}
_WALL, _LOT = {"rgba": [0.4, 0.42, 0.45, 1.0]}, {"rgba": [0.36, 0.62, 0.45, 1.0]}


def domain_of(problem: Mapping[str, Any]) -> tuple[float, float, float, float]:
    """The border of a problem, `(x_min, y_min, x_max, y_max)` in metres; 10 x 10 m where it names none.

    Args:
        problem: The settings of the problem, from a manifest.
    """
    if "half_width" in problem:
        half = float(problem["half_width"])
        return -half, -half, half, half
    x_min, y_min, x_max, y_max = problem.get("domain", _UNKNOWN)
    return float(x_min), float(y_min), float(x_max), float(y_max)


def furnish(spec: Any, problem: Mapping[str, Any], lowest: float = 0.0, highest: float = 0.0) -> None:
    """Put the walls of a problem into a world, and the lot where a robot parks. Nothing can touch them.

    Args:
        spec: The world as it can be edited.
        problem: The settings of the problem, from a manifest.
        lowest: Height of the lowest ground, in metres.
        highest: Height of the highest ground, in metres.
    """
    middle, half = 0.5 * (lowest + highest + WALL_HEIGHT), 0.5 * (highest + WALL_HEIGHT - lowest)
    for x_min, y_min, x_max, y_max in problem.get("walls") or ():
        place = {
            "pos": [0.5 * (x_min + x_max), 0.5 * (y_min + y_max), middle],
            "size": [0.5 * (x_max - x_min), 0.5 * (y_max - y_min), half],
        }
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, **place, **_WALL, **_UNTOUCHED)
    if "half_width" in problem:
        _add_lot(spec, float(problem["distance_tolerance"]))


def _add_lot(spec: Any, radius: float) -> None:
    """A disc on the floor, and a line along the heading wanted there."""
    disc, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="lot", type=disc, size=[radius, 0.0005, 0.0], **_LOT, **_UNTOUCHED)
    line = {"size": [0.75 * radius, 0.15 * radius, 0.0005], "pos": [1.73 * radius, 0.0, 0.0]}
    spec.worldbody.add_geom(name="lot_heading", type=box, **line, **_LOT, **_UNTOUCHED)
