"""Lawnmowers: parallel lines over an area, cell by cell of its boustrophedon decomposition.

Choset and Pignon (1997): as a line sweeps over the area, the pieces that it is cut into by holes split and
merge. Between two such events a piece sweeps a cell, which is driven to and fro; the cells are visited one
after the other, by shortest paths around holes.
"""

import bisect
import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial.distance import cdist
from shapely.geometry.base import BaseGeometry

from bojax.areas.area import Area, edges_of
from bojax.areas.shapes import polygons_of, rings_of, to_shape
from bojax.areas.transfers import Transfers
from bojax.surveys.polylines import driven_at, length_of
from bojax.surveys.turns import Turned, turned

DIRECTIONS = 8
"""Number of directions of the lines that are tried."""

PRECISION = 1e-9
"""Share of a budget that may be left."""

MOST_LINES = 10_000
"""Lines of a direction up to which a spacing is not taken for a mistake."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A connected area, prepared for many routes."""

    shape: BaseGeometry  # its polygon
    transfers: Transfers  # shortest paths in it
    turning_radius: float = 0.0  # least radius of the turns of routes in it, m; 0 for turns on the spot

    @classmethod
    def of(cls, area: Area, near: np.ndarray | None = None, turning_radius: float = 0.0) -> "Ground":
        """The part of an area that contains the point `near`, by default the largest part.

        Raises:
            ValueError: The area is empty, or does not contain the point.
        """
        parts = polygons_of(to_shape(area))
        if not parts:
            raise ValueError("the area is empty")
        if near is not None:
            parts = [part for part in parts if shapely.dwithin(part, shapely.Point(near), 1e-6)]
            if not parts:
                raise ValueError(f"({near[0]:.6g}, {near[1]:.6g}) is not in the area")
        return cls(parts[0], Transfers(parts[0], turning_radius), turning_radius)

    @property
    def rings(self) -> list[np.ndarray]:
        """Its border and those of its holes, each closed by its first corner."""
        return rings_of(self.shape)

    @property
    def size(self) -> float:
        """The area, m^2."""
        return float(self.shape.area)


def lawnmower(
    area: Area | Ground,
    spacing: float,
    angle: float = 0.0,
    start: np.ndarray | None = None,
    end: np.ndarray | None = None,
    inset: bool = False,
) -> Turned:
    """A route along parallel lines that covers an area.

    Args:
        area: The area; of several parts, the one with the start or else the largest is covered.
        spacing: Largest distance between two lines, m.
        angle: Direction of the lines, counter-clockwise from x, rad.
        start: First point of the route; free if None.
        end: Last point of the route; free if None.
        inset: Whether lines stop half a spacing before the border, or at it; with a turning radius, this far
            before it.

    Returns:
        Waypoints `[W, 2]`, m, and what its turns leave out.

    Raises:
        ValueError: The spacing is one of too many lines, or an end is not in the area.
        TurnsTooTight: The turning radius of the ground does not allow such a route.
    """
    ground = area if isinstance(area, Ground) else Ground.of(area, start if start is not None else end)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    rings = [ring[:-1] @ turn.T for ring in ground.rings]
    found, between = _cells(rings, spacing, None if inset else ground.turning_radius)
    cells = [[line @ turn for line in cell] for cell in found]
    legs = _in_order([_ways(cell, between, ground.turning_radius) for cell in cells], start, end)
    stops = [np.asarray(start, float)[None]] if start is not None else []
    stops += legs
    stops += [np.asarray(end, float)[None]] if end is not None else []
    return _turned(joined(stops, ground.transfers), ground)


def lawnmowers_within(
    ground: Ground,
    budget: float,
    angle: float = 0.0,
    start: np.ndarray | None = None,
    end: np.ndarray | None = None,
    spacing: float = 0.0,
) -> list[Turned]:
    """Lawnmowers of one direction that are at most as long as the budget, m; arguments are as of `lawnmower`.

    The spacing is the least distance between two lines.

    Returns:
        The one with the closest lines of those that cover the whole area, if the budget is enough for one;
        and the next closer one, cut where the way to the end uses up the rest of the budget.

    Raises:
        ValueError: The budget does not reach from the start to the end.
        TurnsTooTight: The turning radius of the ground does not allow any.
    """
    check_budget(ground, budget, start, end)
    # Lines of this distance are as long as the budget, but for the way between them.
    typical = ground.size / budget
    x_min, y_min, x_max, y_max = ground.shape.bounds
    spacing = max(spacing, 1.01 * math.hypot(x_max - x_min, y_max - y_min) / MOST_LINES)
    powers = [typical * 1.06**power for power in range(-8, 28)]
    denser = whole = None
    for distance in [spacing, *powers] if spacing > powers[0] else powers:
        if distance < spacing:
            continue
        try:
            found = lawnmower(ground, distance, angle, start, end, inset=True)
        except TurnsTooTight:
            continue
        if length_of(found.route) <= budget:
            whole = found
            break
        denser = found
    routes = [] if whole is None else [whole]
    if denser is not None:
        with contextlib.suppress(TurnsTooTight):  # at the beginning of the way to the end
            shorter = _turned(cut(denser.route, budget, end, ground.transfers), ground)
            routes.append(Turned(shorter.route, max(shorter.left_out, denser.left_out)))
    if not routes:
        raise TurnsTooTight(ground.turning_radius)
    return routes


def check_budget(
    ground: Ground, budget: float, start: np.ndarray | None = None, end: np.ndarray | None = None
) -> None:
    """Refuse a budget that is not positive, or does not reach from the start to the end.

    Raises:
        ValueError: The budget is too small.
    """
    if not budget > 0 or not math.isfinite(budget):
        raise ValueError(f"budget: got {budget:g} m; allowed: > 0 m")
    if start is not None and end is not None:
        shortest = length_of(ground.transfers.path(np.asarray(start, float), np.asarray(end, float)))
        if shortest > budget:
            raise too_small(budget, shortest)


def too_small(budget: float, shortest: float) -> ValueError:
    """The error of a budget that is less than the shortest way."""
    between = f"the shortest way from the start to the end is {shortest:.6g} m long"
    return ValueError(f"budget: got {budget:.6g} m, but {between}")


class TurnsTooTight(ValueError):
    """No lawnmower can be driven with the turning radius."""

    def __init__(self, radius: float):
        super().__init__(
            f"turning radius: got {radius:g} m, with which no lawnmower stays in the area; allowed: a "
            f"smaller one, or lines at least {2 * radius:g} m apart"
        )


def _turned(route: np.ndarray, ground: Ground) -> Turned:
    """The route with turns of the radius of the ground.

    Raises:
        TurnsTooTight: It leaves too little room for them.
    """
    found = turned(route, ground.turning_radius)
    if found is None or not (
        found.route is route or ground.transfers.are_clear(found.route[:-1], found.route[1:]).all()
    ):
        raise TurnsTooTight(ground.turning_radius)
    return found


def _cells(
    rings: list[np.ndarray], spacing: float, headland: float | None
) -> tuple[list[list[np.ndarray]], float]:
    """Cells of parallel lines to x, each a list of pieces `[2, 2]` from the lowest y, and their distance."""
    corners = np.concatenate(rings)
    low, high = corners[:, 1].min(), corners[:, 1].max()
    number = max(1, math.ceil((high - low) / spacing - 1e-9))
    if number > MOST_LINES:
        least = (high - low) / MOST_LINES
        raise ValueError(
            f"spacing: got {spacing:g} m, {number:,} lines; allowed: at least {least:.3g} m here"
        )
    between = (high - low) / number
    headland = between / 2.0 if headland is None else headland
    heights = low + (np.arange(number) + 0.5) * (high - low) / number
    edges = edges_of(rings)
    done: list[list[np.ndarray]] = []
    growing: list[tuple[np.ndarray, list[np.ndarray]]] = []  # the last piece and the cell of each
    for y in heights:
        pieces = _pieces(edges, y)
        touches = np.array(
            [[last[0] < piece[1] and piece[0] < last[1] for piece in pieces] for last, _ in growing], bool
        ).reshape(len(growing), len(pieces))
        now = []
        for index, piece in enumerate(pieces):
            # A short line keeps half of its length.
            gap = min(headland, 0.25 * (piece[1] - piece[0]))
            line = np.array([[piece[0] + gap, y], [piece[1] - gap, y]])
            before = np.flatnonzero(touches[:, index])
            goes_on = len(before) == 1 and touches[before[0]].sum() == 1
            cell = growing[before[0]][1] if goes_on else []
            if not goes_on:
                done.append(cell)
            cell.append(line)
            now.append((piece, cell))
        growing = now
    return done, between


def _pieces(edges: tuple[np.ndarray, np.ndarray], y: float) -> list[np.ndarray]:
    """Pieces `[x_min, x_max]` in which the line at a height cuts the area within edges, as of `edges_of`."""
    first, last = edges
    spans = (first[:, 1] > y) != (last[:, 1] > y)
    first, last = first[spans], last[spans]
    share = (y - first[:, 1]) / (last[:, 1] - first[:, 1])
    crossings = first[:, 0] + share * (last[:, 0] - first[:, 0])
    return list(np.sort(crossings).reshape(-1, 2))


def _ways(cell: list[np.ndarray], spacing: float, turning_radius: float) -> list[np.ndarray]:
    """The four ways to drive a cell to and fro: from the first or the last line, from either side."""
    ways = []
    order = _order_apart(len(cell), math.ceil(2.0 * turning_radius / spacing - 1e-9))
    for lines in (cell, cell[::-1]):
        for side in (0, 1):
            driven = [lines[index][:: 1 if (i + side) % 2 == 0 else -1] for i, index in enumerate(order)]
            ways.append(np.concatenate(driven))
    return ways


def _order_apart(number: int, least: int) -> list[int]:
    """An order of lines in which consecutive ones are at least `least` apart, if there are enough lines.

    Blocks of 2 k + 1 lines alternate between k + 1 ahead and k back.
    """
    if least <= 1:
        return list(range(number))
    order, size = [], 2 * least + 1
    for begin in range(0, max(number - size, 0) + 1, size):
        block = list(range(begin, begin + size if begin + 2 * size <= number else number))
        half = (len(block) + 1) // 2
        order += [line for pair in itertools.zip_longest(block[:half], block[half:]) for line in pair]
    return [line for line in order if line is not None]


def _in_order(
    cells: list[list[np.ndarray]], start: np.ndarray | None, end: np.ndarray | None
) -> list[np.ndarray]:
    """One way for each cell, in an order with short transfers: the nearest next, from each first way.

    Distances between cells are straight lines here; the transfers that are driven go around holes.
    """
    ways = [way for cell in cells for way in cell]
    firsts, lasts = np.array([way[0] for way in ways]), np.array([way[-1] for way in ways])
    cell_of = np.repeat(np.arange(len(cells)), 4)
    between = cdist(lasts, firsts)
    from_start = np.zeros(len(ways)) if start is None else cdist([start], firsts)[0]
    to_end = np.zeros(len(ways)) if end is None else cdist(lasts, [end])[:, 0]
    best, least = [], math.inf
    seeds = np.arange(len(ways)) if len(ways) <= 200 else np.argsort(from_start)[:50]
    for seed in seeds:
        order, cost = [int(seed)], float(from_start[seed])
        is_left = cell_of != cell_of[seed]
        while is_left.any():
            steps = np.where(is_left, between[order[-1]], np.inf)
            if is_left.sum() == 4:  # the last cell: how it ends matters
                steps = steps + to_end
            following = int(np.argmin(steps))
            cost += between[order[-1], following]
            order.append(following)
            is_left &= cell_of != cell_of[following]
        cost += to_end[order[-1]]
        if cost < least:
            best, least = order, cost
    return [ways[index] for index in best]


def joined(legs: Sequence[np.ndarray], transfers: Transfers) -> np.ndarray:
    """One route over all legs, with transfers within and between them that stay in the area."""
    points = np.concatenate(legs)
    is_clear = transfers.are_clear(points[:-1], points[1:])
    route = [points[:1]]
    for index in range(len(points) - 1):
        if is_clear[index]:
            route.append(points[index + 1 : index + 2])
        else:
            route.append(transfers.path(points[index], points[index + 1])[1:])
    return np.concatenate(route)


def cut(route: np.ndarray, budget: float, end: np.ndarray | None, transfers: Transfers) -> np.ndarray:
    """The beginning of a route and the way to its end, together at most as long as the budget."""
    driven = driven_at(route)

    def at(distance: float) -> np.ndarray:
        index = int(np.searchsorted(driven, distance, side="right")) - 1
        share = (distance - driven[index]) / (driven[index + 1] - driven[index])
        return (1.0 - share) * route[index] + share * route[index + 1]

    if end is None:
        is_whole = budget >= driven[-1]
        return route if is_whole else np.concatenate([route[driven <= budget], at(budget)[None]])
    end = np.asarray(end, float)
    # The total length never falls along the route, since the way to the end shortens by no more than what was
    # driven. So the waypoints at which the budget still suffices come first; at the start it does.
    beyond = bisect.bisect_left(
        range(len(route)),
        True,
        lo=1,
        key=lambda index: driven[index] + length_of(transfers.path(route[index], end)) > budget,
    )
    low, way = float(driven[beyond - 1]), transfers.path(route[beyond - 1], end)
    if beyond < len(route):
        high = float(driven[beyond])
        direction = (route[beyond] - route[beyond - 1]) / (high - low)
        resolution = PRECISION * budget
        while high - low > resolution:
            trial = low + _farther(way, direction, budget - low)
            if trial - low <= resolution:
                break
            found = transfers.path(at(trial), end) if trial < high else None
            if found is None or trial + length_of(found) > budget:  # around another corner
                high, trial = min(high, trial), (low + min(high, trial)) / 2.0
                found = transfers.path(at(trial), end)
            if trial + length_of(found) > budget:
                high = trial
            else:
                low, way = trial, found
    return np.concatenate([route[driven < low], way])


def _farther(way: np.ndarray, direction: np.ndarray, left: float) -> float:
    """How far one can go first, m, if the next waypoint of a way then still is in sight.

    What is `left` suffices for the distance t in the `direction` d, the straight line to that waypoint, and
    the rest of the way. With the vector a from the waypoint to here, t + |a + t d| is what is left for both
    legs: the point lies on an ellipse.
    """
    offset = way[0] - way[1]
    legs = (1.0 - PRECISION) * left - length_of(way[1:])  # a little less, or rounding might exceed the budget
    divisor = 2.0 * (legs + offset @ direction)
    return float((legs**2 - offset @ offset) / divisor) if divisor > 0.0 else 0.0
