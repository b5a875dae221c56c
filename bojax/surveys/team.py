"""Several robots: a part of the area for each, lawnmowers over the parts, and the distance robots keep."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from bojax.areas.shapes import shapely_module
from bojax.surveys.lawnmower import Ground, lawnmower, lawnmowers_within
from bojax.surveys.polylines import Waypoints, length_of, points_along

Point = np.ndarray | None
"""An end of a route, m; None if it is free."""


def parts_of(ground: Ground, number: int, angle: float) -> list[Ground]:
    """The ground cut into parts of equal size by lines in a direction, with the transfers of the whole."""
    if number == 1:
        return [ground]
    shapely = shapely_module()
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
    return [Ground(between(*pair), ground.transfers) for pair in itertools.pairwise([*edges, high])]


def team_lawnmowers(
    ground: Ground,
    number: int,
    angle: float,
    starts: Sequence[Point],
    ends: Sequence[Point],
    budget: float | None,
    spacing: float,
) -> list[list[Waypoints]]:
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


def least_distance(routes: Sequence[Waypoints], apart_from_ends: float = 0.0) -> float:
    """Least distance of two robots that drive equally fast, m; infinite for one.

    The first and the last `apart_from_ends` metres do not count; a robot stays where its route ends.
    """
    least, longest = math.inf, max(map(length_of, routes))
    distances = np.linspace(apart_from_ends, max(longest - apart_from_ends, apart_from_ends), 1000)
    for first, second in itertools.combinations(routes, 2):
        apart = np.linalg.norm(points_along(first, distances) - points_along(second, distances), axis=1)
        least = min(least, float(apart.min()))
    return least


def keep_separation(routes: Sequence[Waypoints], separation: float) -> bool:
    """Whether robots stay apart but for the first and the last `separation` metres of their routes."""
    return least_distance(routes, separation) >= separation


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
