"""Several robots: a part of the area for each, lawnmowers over the parts, and the distance robots keep."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from bojax.surveys.lawnmower import Ground, lawnmower, lawnmowers_within
from bojax.surveys.polylines import Waypoints, distance_to, driven_at, length_of, points_along
from bojax.surveys.turns import Turned

MOST_ROBOTS = 4
"""Largest number of robots that are planned together."""

FAN = 2.0
"""Separations that robots drive to come apart from a common start: four from a corner, 30 degrees apart."""

Point = np.ndarray | None
"""An end of a route, m; None if it is free."""


def parts_of(ground: Ground, number: int, angle: float) -> list[Ground]:
    """The ground cut into parts of equal size by lines in a direction, with the transfers of the whole."""
    if number == 1:
        return [ground]
    across = np.array([-math.sin(angle), math.cos(angle)])
    along = np.array([across[1], -across[0]])
    heights = np.concatenate(ground.rings) @ across
    low, high = heights.min(), heights.max()
    reach = np.ptp(np.concatenate(ground.rings), axis=0).sum() * along
    middle = np.concatenate(ground.rings).mean(axis=0)
    middle = middle - (middle @ across) * across

    def between(bottom: float, top: float):
        sides = [middle + height * across for height in (bottom, top)]
        corners = [sides[0] - reach, sides[0] + reach, sides[1] + reach, sides[1] - reach]
        return shapely.intersection(ground.shape, shapely.Polygon(corners))

    edges = [low]
    for share in np.arange(1, number) / number:
        bottom, top = edges[-1], high
        for _ in range(50):
            height = (bottom + top) / 2
            is_too_low = between(low, height).area < share * ground.size
            bottom, top = (height, top) if is_too_low else (bottom, height)
        edges.append((bottom + top) / 2)
    return [replace(ground, shape=between(*pair)) for pair in itertools.pairwise([*edges, high])]


def team_lawnmowers(
    ground: Ground,
    number: int,
    angle: float,
    starts: Sequence[Point],
    ends: Sequence[Point],
    budget: float | None,
    spacing: float,
) -> list[list[Turned]]:
    """Lawnmowers of several robots, one in a part each; with a budget, also the next closer ones, cut.

    Raises:
        ValueError: The budget does not reach from a start to its end.
    """
    parts = parts_of(ground, number, angle)
    middles = [part.shape.representative_point().coords[0] for part in parts]
    parts = [parts[index] for index in _assigned(np.array(middles), starts, ends)]
    if budget is None:
        together = zip(parts, starts, ends, strict=True)
        return [[lawnmower(part, spacing, angle, start, end) for part, start, end in together]]
    options = [
        lawnmowers_within(part, budget, angle, start, end, spacing)
        for part, start, end in zip(parts, starts, ends, strict=True)
    ]
    most = max(map(len, options))
    return [[each[min(index, len(each) - 1)] for each in options] for index in range(most)]


def split_points(
    points: Waypoints, number: int, angle: float, starts: Sequence[Point], ends: Sequence[Point]
) -> list[Waypoints]:
    """The points cut into strips of equal size in a direction, one for each robot."""
    if number == 1:
        return [points]
    order = np.argsort(points @ [-math.sin(angle), math.cos(angle)], kind="stable")
    strips = [points[part] for part in np.array_split(order, number)]
    middles = np.array([strip.mean(axis=0) for strip in strips])
    return [strips[index] for index in _assigned(middles, starts, ends)]


def least_distance(routes: Sequence[Waypoints], separation: float = 0.0) -> float:
    """Least distance of two robots that drive equally fast, m; infinite for one.

    A robot stays where its route ends. If two robots start closer than the separation, as at a mooring,
    the first `FAN` separations of their routes do not count; if they end closer, nor do the last ones.
    """
    return min(
        (_distance_of(*pair, separation) for pair in itertools.combinations(routes, 2)), default=math.inf
    )


def _distance_of(first: Waypoints, second: Waypoints, separation: float) -> float:
    starts_together, ends_together = (
        float(np.linalg.norm(first[index] - second[index])) < separation for index in (0, -1)
    )
    longest = max(length_of(first), length_of(second))
    begin = FAN * separation if starts_together else 0.0
    end = max(longest - FAN * separation, begin) if ends_together else longest
    # Between two corners of either route, both robots move along straight lines.
    corners = np.concatenate([[begin, end], driven_at(first), driven_at(second)])
    distances = np.unique(np.clip(corners, begin, end))
    apart = points_along(first, distances) - points_along(second, distances)
    return distance_to(np.zeros(2), apart)


def keep_separation(routes: Sequence[Waypoints], separation: float, others: Sequence[Waypoints] = ()) -> bool:
    """Whether robots stay a separation apart, and away from other ones, see `least_distance`."""
    together = [*itertools.combinations(routes, 2), *itertools.product(routes, others)]
    return all(least_distance(pair, separation) >= separation * (1.0 - 1e-9) for pair in together)


def _assigned(middles: np.ndarray, starts: Sequence[Point], ends: Sequence[Point]) -> Sequence[int]:
    """The part of each robot, so that the ways from the starts and to the ends are short."""

    def cost(order: Sequence[int]) -> float:
        ways = [
            float(np.linalg.norm(middles[part] - end))
            for pair in (starts, ends)
            for part, end in zip(order, pair, strict=True)
            if end is not None
        ]
        return sum(ways)

    return min(itertools.permutations(range(len(middles))), key=cost)
