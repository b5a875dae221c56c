"""The planner that drives a lawnmower: the baseline that covers an area without a look at the field."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Array, Float
from shapely.geometry.base import BaseGeometry
from typing_extensions import override

from bojax.areas.area import Area
from bojax.areas.shapes import polygons_of, to_shape
from bojax.areas.transfers import Transfers
from bojax.motions.polylines import points_along
from bojax.planning.route import RouteFollower
from bojax.problems.budgets import distance_of
from bojax.problems.field_belief import FieldBelief
from bojax.problems.field_problem import FieldProblem
from bojax.problems.walls import Boxes
from bojax.problems.ways_to_end import WaysToEnd, ways_around
from bojax.surveys.lawnmower import DIRECTIONS, Ground, cut, lawnmower, lawnmowers_within
from bojax.surveys.polylines import Waypoints, length_of

WAYPOINTS = 64  # the number of waypoints is a multiple of this
GRID_POINTS = 400  # of the area, whose distances from routes are compared
CLEARANCES = (0.5, 0.05, 0.005)  # from obstacles, as shares of the distance between two poses


class Lawnmower(RouteFollower):
    """A route along parallel lines over the area of a field problem.

    It is laid on the host when the planner meets its problem, starts at the start and ends at the end point,
    if they are set, and is as long as the budget or `max_steps` pieces. With distance left and no end point,
    the robot drives it back. From a random start, it drives the shortest way to the first line; half a
    diagonal of the domain is left for that. Of several parts of an area, it covers the one
    with the start, or else the one with the end or the largest.

    Settings: `bojax.surveys.settings.Lawnmower`.
    """

    # Largest distance between two lines, m; None for lines as long as what can be driven
    spacing: Float[Array, ""] | None
    direction: Float[Array, ""] | None  # direction of the lines, rad; None for the best one of several
    approach: WaysToEnd | None  # ways to the first waypoint; None if the route begins at the start

    def __init__(
        self,
        length: Float[Array, ""],
        num_samples: int = 10,
        spacing: Float[Array, ""] | None = None,
        direction: Float[Array, ""] | None = None,
    ):
        """A planner without waypoints; `prepared` lays them."""
        self.waypoints = jnp.zeros((0, 2), length.dtype)
        self.length, self.size = length, num_samples
        self.spacing, self.direction, self.approach = spacing, direction, None

    @override
    def prepared(self, problem: Any) -> "Lawnmower":
        if not isinstance(problem, FieldProblem):
            return self  # `check` refuses it
        clearance, free = _free_space(problem, float(self.length) / self.size)
        route = self._laid(problem, free)
        if problem.end is None:
            route = np.concatenate([route, route[-2::-1]])
        # A round number of waypoints: the routes of a sweep share programs.
        spare = -len(route) % WAYPOINTS
        waypoints = jnp.asarray(np.pad(route, ((0, spare), (0, 0)), mode="edge"), self.length.dtype)
        approach = None
        if problem.start is None:
            walls = _grown(problem.walls, clearance)
            approach = ways_around(waypoints[0], problem.domain, walls, problem.area)
        return eqx.tree_at(
            lambda planner: (planner.waypoints, planner.approach),
            self,
            (waypoints, approach),
            is_leaf=lambda node: node is None,
        )

    @override
    def points(
        self, belief: FieldBelief, distances: Float[Array, "S"], step: Float[Array, ""]
    ) -> Float[Array, "S 2"]:
        if self.approach is None:
            return super().points(belief, distances, step)
        # A belief keeps no start, but the first sample, which is one pose after it.
        is_first = belief.step == 0
        begin = jnp.where(is_first, belief.pose[:2], belief.posterior.x[0])
        route = jnp.concatenate([self.approach.way(begin), self.waypoints])
        return points_along(route, distances - jnp.where(is_first, 0.0, step), step)[0]

    def _laid(self, problem: FieldProblem, free: BaseGeometry) -> Waypoints:
        start = None if problem.start is None else np.asarray(problem.start[:2], float)
        ends = start, None if problem.end is None else np.asarray(problem.end, float)
        parts, anchor = polygons_of(free), ends[0] if start is not None else ends[1]
        if not parts:
            raise ValueError("problem: no free space to lay a lawnmower in; allowed: another planner")
        if anchor is not None:
            parts.sort(key=lambda part: shapely.distance(part, shapely.Point(anchor)))
        ground = Ground(parts[0], Transfers(parts[0]))
        inside = [None if end is None else _nearest(ground, end) for end in ends]
        left = self._drivable(problem) - sum(
            float(np.linalg.norm(end - near))
            for end, near in zip(ends, inside, strict=True)
            if end is not None and near is not None
        )
        angles = np.arange(DIRECTIONS) * math.pi / DIRECTIONS
        routes = [
            self._along(ground, angle, left, *inside)
            for angle in (angles if self.direction is None else [float(self.direction)])
        ]
        route = min(routes, key=lambda route: _mean_distance(ground, route)) if len(routes) > 1 else routes[0]
        return route if start is None else np.concatenate([start[None], route])

    def _along(
        self, ground: Ground, angle: float, budget: float, start: np.ndarray | None, end: np.ndarray | None
    ) -> Waypoints:
        """The lawnmower of a direction, at most as long as the budget."""
        if self.spacing is None:
            return lawnmowers_within(ground, budget, angle, start, end)[0].route
        route = lawnmower(ground, float(self.spacing), angle, start, end, inset=True).route
        return route if length_of(route) <= budget else cut(route, budget, end, ground.transfers)

    def _drivable(self, problem: FieldProblem) -> float:
        """The length that the route can have, m."""
        total = problem.max_steps * float(self.length)
        budget = distance_of(problem.budget, problem.time_budget, problem.speed)
        if budget is not None:
            total = min(total, float(budget))
        if problem.start is not None:
            return total
        x_min, y_min, x_max, y_max = np.asarray(problem.domain, float)
        return total - min(0.5 * math.hypot(x_max - x_min, y_max - y_min), 0.5 * total)


def _free_space(problem: FieldProblem, step: float) -> tuple[float, BaseGeometry]:
    """A distance to keep from obstacles, m, and the space with it: without it, corners would be cut.

    It does not close a passage: as many parts remain as without it.
    """

    def space(clearance: float) -> BaseGeometry:
        free = shapely.box(*np.asarray(problem.domain, float).tolist())
        if problem.area is not None:
            area = to_shape(problem.area.area).buffer(-clearance, join_style="mitre")
            free = shapely.intersection(free, area)
        for wall in () if problem.walls is None else np.asarray(_grown(problem.walls, clearance), float):
            free = shapely.difference(free, shapely.box(*wall.tolist()))
        return free

    number = len(polygons_of(space(0.0)))
    *wide, least = (share * step for share in CLEARANCES)
    clearance = next((each for each in wide if len(polygons_of(space(each))) == number), least)
    return clearance, space(clearance)


def _grown(walls: Boxes | None, clearance: float) -> Boxes | None:
    return None if walls is None else walls + clearance * jnp.asarray([[-1.0, -1.0, 1.0, 1.0]], walls.dtype)


def _nearest(ground: Ground, point: np.ndarray) -> np.ndarray:
    return np.array(shapely.shortest_line(ground.shape, shapely.Point(point)).coords[0])


def _mean_distance(ground: Ground, route: Waypoints) -> float:
    """Mean distance of the points of an area from a route, m."""
    points = Area(tuple(ground.rings)).grid(math.sqrt(ground.size / GRID_POINTS))
    return float(np.mean(shapely.distance(shapely.LineString(route), shapely.points(points))))
