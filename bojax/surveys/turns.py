"""Turns of a least radius: an arc at each corner of a route that touches both of its legs.

At a corner where a route turns by an angle a, an arc of radius r takes up r tan(a / 2) of both legs. A
vehicle can drive a route whose legs are long enough for the arcs at both of their ends.
"""

import math
from typing import NamedTuple

import numpy as np

from bojax.surveys.polylines import Waypoints, legs_of

PIECE = math.radians(15.0)
"""Largest turn at one waypoint of a route that is written; a larger one is divided."""

ROUNDING = 1e-9  # share of a radius by which a turn may be tighter

LARGEST = 1e6  # tangent of half of a turn on the spot

MOST_REMOVED = 1 / 3  # of the waypoints of a route


def least_radius(route: Waypoints) -> float:
    """The radius of the tightest turn of a route, m: the largest with which it can be driven."""
    if len(route) < 3:
        return math.inf
    half, lengths = _half_tangents(route), legs_of(route)
    needed = half[:-1] + half[1:]
    return float(np.min(lengths[needed > 0.0] / needed[needed > 0.0], initial=math.inf))


class Turned(NamedTuple):
    """A route with turns of at least a radius."""

    route: Waypoints  # waypoints `[W, 2]`, m
    left_out: float  # share of the waypoints that were removed, since they left too little room for turns


def drivable(route: Waypoints, radius: float) -> Waypoints | None:
    """The route of `turned`, or None."""
    found = turned(route, radius)
    return None if found is None else found.route


def turned(route: Waypoints, radius: float) -> Turned | None:
    """A route with turns of at least a radius, no longer than the given one, or None if there is none nearby.

    Waypoints that leave too little room for turns are removed. Turns are then written as polygons around
    their arcs, so that the arc of this radius touches each leg of the result.

    Raises:
        ValueError: The radius is negative or not a number.
    """
    if not radius >= 0.0:
        raise ValueError(f"turning radius: got {radius:g}; allowed: >= 0 m")
    if radius == 0.0:
        return Turned(route, 0.0)
    route = route[np.append(True, legs_of(route) > 0.0)]
    number = len(route)
    most = int(MOST_REMOVED * number)
    while (lacking := _lacking(route, radius)).max(initial=0.0) > ROUNDING * radius:
        worst = int(np.argmax(lacking))
        inner = range(max(worst - 1, 1), min(worst + 2, len(route) - 2) + 1)
        if not inner or most == 0:
            return None
        shorter = [np.delete(route, index, axis=0) for index in inner]
        route = min(shorter, key=lambda each: float(_lacking(each, radius).sum()))
        most -= 1
    return Turned(_rounded(route, radius), 1.0 - len(route) / number)


def _rounded(route: Waypoints, radius: float) -> Waypoints:
    """The route with each turn of more than `PIECE` divided along its arc."""
    half, legs = _half_tangents(route), np.diff(route, axis=0)
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    points = [route[:1]]
    for index in range(1, len(route) - 1):
        turn = math.remainder(headings[index] - headings[index - 1], 2.0 * math.pi)
        pieces = max(1, math.ceil(abs(turn) / PIECE - 1e-9))
        step = radius * math.tan(abs(turn) / pieces / 2.0)
        # Along the legs of the polygon: half of one before the first corner, then whole ones.
        directions = headings[index - 1] + turn * np.arange(pieces) / pieces
        moves = np.where(np.arange(pieces) == 0, step, 2.0 * step)[:, None]
        moves = moves * np.stack([np.cos(directions), np.sin(directions)], axis=1)
        begin = route[index] - radius * half[index] * moves[0] / step if step > 0.0 else route[index]
        points.append(begin + np.cumsum(moves, axis=0))
    return np.concatenate([*points, route[-1:]])


def _lacking(route: Waypoints, radius: float) -> np.ndarray:
    """The length `[W - 1]` that each leg lacks for the arcs at its ends, m; negative if it is long enough."""
    half = _half_tangents(route)
    return radius * (half[:-1] + half[1:]) - legs_of(route)


def _half_tangents(route: Waypoints) -> np.ndarray:
    """Tangent `[W]` of half of the angle by which a route turns at each waypoint; 0 at its ends."""
    before, after = np.diff(route, axis=0)[:-1], np.diff(route, axis=0)[1:]
    across = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    lengths = legs_of(route)
    # From the cosine, rounding would make a turn on the spot a straight line.
    angle = np.arctan2(across, np.sum(before * after, axis=1))
    is_leg = lengths[:-1] * lengths[1:] > 0.0
    half = np.where(is_leg, np.minimum(np.tan(angle / 2.0), LARGEST), LARGEST)
    return np.concatenate([[0.0], half, [0.0]])
