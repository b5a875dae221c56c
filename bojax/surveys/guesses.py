"""First guesses of routes: parallel lines in several directions, and tours through random points."""

import numpy as np

from bojax.surveys.polylines import Waypoints, length_of


def parallel_lines(
    points: Waypoints, angle: float, budget: float, start: Waypoints | None, end: Waypoints | None
) -> Waypoints:
    """As many parallel lines across the points as the budget allows, driven to and fro.

    The lines cross gaps between the points: a first guess, not a route. Of the four ways to drive the lines,
    the shortest with the way to the ends is taken. Without a budget for two lines, one line. Lengths are in
    metres, and the angle in radians.
    """
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    along, across = (points @ turn.T).T
    low, high = across.min(), across.max()
    best = None
    for number in range(1, 200):
        width = (high - low) / number
        lines = []
        for row in range(number):
            near = np.abs(across - low - (row + 0.5) * width) <= 0.5 * width
            if np.any(near):
                # Half a width from the border: what a line sees reaches beyond it.
                first, last = along[near].min(), along[near].max()
                inset = min(0.5 * width, 0.25 * (last - first))
                at = low + (row + 0.5) * width
                lines.append(np.array([[first + inset, at], [last - inset, at]]))
        ways = [
            np.concatenate([line[:: 1 if (row + side) % 2 else -1] for row, line in enumerate(order)])
            for order in (lines, lines[::-1])
            for side in (0, 1)
        ]
        routes = [_between(way @ turn, start, end) for way in ways]
        shortest = min(routes, key=length_of)
        if best is not None and length_of(shortest) > budget:
            break
        best = shortest
    assert best is not None
    return best


def tour(
    points: Waypoints,
    number: int,
    start: Waypoints | None,
    end: Waypoints | None,
    random: np.random.Generator,
) -> Waypoints:
    """A short tour through `number` points that are far from each other, from a random first one.

    Farthest-point sampling, then the nearest unvisited point each time, then 2-opt.
    """
    chosen = [points[random.integers(len(points))]]
    distance = np.linalg.norm(points - chosen[0], axis=1)
    for _ in range(min(number, len(points)) - 1):
        chosen.append(points[np.argmax(distance)])
        distance = np.minimum(distance, np.linalg.norm(points - chosen[-1], axis=1))
    left, order = list(chosen), []
    at = start if start is not None else left[0]
    while left:
        nearest = int(np.argmin([np.linalg.norm(point - at) for point in left]))
        at = left.pop(nearest)
        order.append(at)
    return _uncrossed(_between(np.array(order), start, end))


def _between(route: Waypoints, start: Waypoints | None, end: Waypoints | None) -> Waypoints:
    ends = [[part] if part is not None else [] for part in (start, end)]
    return np.array([*ends[0], *route, *ends[1]])


def _uncrossed(route: Waypoints) -> Waypoints:
    """2-opt: reverse a part of the route as long as this shortens it; its ends stay."""
    route = route.copy()
    is_shorter = True
    while is_shorter:
        is_shorter = False
        for i in range(len(route) - 2):
            for j in range(i + 2, len(route) - 1):
                a, b, c, d = route[i], route[i + 1], route[j], route[j + 1]
                gain = _gap(a, b) + _gap(c, d) - _gap(a, c) - _gap(b, d)
                if gain > 1e-9:
                    route[i + 1 : j + 1] = route[i + 1 : j + 1][::-1].copy()
                    is_shorter = True
    return route


def _gap(a: Waypoints, b: Waypoints) -> float:
    return float(np.hypot(*(a - b)))
