"""Routes as polylines of waypoints, in NumPy: routes of many sizes would each compile a program."""

import numpy as np

Waypoints = np.ndarray  # [W, 2], m


def legs_of(route: Waypoints) -> np.ndarray:
    """Lengths `[W - 1]` of the pieces of a polyline, m."""
    return np.linalg.norm(np.diff(route, axis=0), axis=1)


def length_of(route: Waypoints) -> float:
    """Length of a polyline, m."""
    return float(np.sum(legs_of(route)))


def driven_at(route: Waypoints) -> np.ndarray:
    """Distance from the start at each waypoint `[W]`, m."""
    return np.append(0.0, np.cumsum(legs_of(route)))


def points_along(route: Waypoints, distances: np.ndarray) -> Waypoints:
    """Points at distances from the start of a polyline; its last one beyond its end."""
    driven = driven_at(route)
    return np.stack([np.interp(distances, driven, route[:, axis]) for axis in (0, 1)], axis=-1)


def with_waypoints(route: Waypoints, number: int, evenly: bool = False) -> Waypoints:
    """The same polyline with `number` waypoints, if it has fewer: its longest pieces are divided.

    A polyline with more, or any one if they are to be even, is replaced by `number` points at equal distances
    along it.
    """
    if evenly or len(route) > number:
        return points_along(route, np.linspace(0.0, length_of(route), number))
    lengths = legs_of(route)
    parts = np.ones(len(lengths), int)
    for _ in range(number - len(route)):
        parts[np.argmax(lengths / parts)] += 1
    pieces = [
        first + (last - first) * np.arange(count)[:, None] / count
        for first, last, count in zip(route[:-1], route[1:], parts, strict=True)
    ]
    return np.concatenate([*pieces, route[-1:]])


def distance_to(position: np.ndarray, route: Waypoints) -> float:
    """Distance of a position `[2]` from a polyline, which may be a single point."""
    nearest = route if len(route) == 1 else _nearest_of_pieces(position, route)[0]
    return float(np.linalg.norm(nearest - position, axis=1).min())


def rest_of(route: Waypoints, position: np.ndarray) -> Waypoints:
    """A position `[2]`, and the part of a polyline that lies ahead of its point nearest to it."""
    driven = driven_at(route)
    nearest, share = _nearest_of_pieces(position, route)
    piece = int(np.argmin(np.linalg.norm(nearest - position, axis=1)))
    at = driven[piece] + share[piece] * (driven[piece + 1] - driven[piece])
    is_ahead = (driven > at) | (np.arange(len(route)) == len(route) - 1)
    return np.concatenate([position[None], route[is_ahead]])


def _nearest_of_pieces(position: np.ndarray, route: Waypoints) -> tuple[Waypoints, np.ndarray]:
    """The point of each piece that is nearest to a position, and the share of the piece before it."""
    begins, ways = route[:-1], np.diff(route, axis=0)
    squared = np.maximum(np.sum(ways**2, axis=1), np.finfo(float).tiny)
    share = np.clip(np.sum((position - begins) * ways, axis=1) / squared, 0.0, 1.0)
    return begins + share[:, None] * ways, share
