"""A survey that goes on: plan the rest, drive a part of it, tell what was measured, plan again."""

import dataclasses
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bojax.areas.area import Area, check_inside, longer_side
from bojax.areas.shapes import to_area
from bojax.models.gaussian_process import GaussianProcess
from bojax.surveys.goals import Goal, goal_of
from bojax.surveys.lawnmower import MOST_LINES, Ground, too_small
from bojax.surveys.measurements import LEAST_DATA, MOST_EXACT, Measurements
from bojax.surveys.mission_file import read_mission, write_mission
from bojax.surveys.planning import Demand, lawnmower_guesses
from bojax.surveys.polylines import Waypoints, length_of, rest_of
from bojax.surveys.route import (
    NUM_GRID,
    ROUNDING,
    Robot,
    Route,
    RouteOptions,
    counted_points,
    plan_routes,
    spread_points,
    stays_inside,
)
from bojax.surveys.search import Search
from bojax.surveys.team import MOST_ROBOTS
from bojax.surveys.turns import drivable
from bojax.surveys.validation import above_zero, numbers, positions, rows

OPTIONS = RouteOptions(restarts=4, steps=120, models=4)  # the earlier plan is a good first guess

FAR = 0.5  # sizes of the area beyond its bounds at which a position is taken for an error
MOST_MAPPED = 1024  # measurements up to which the belief is exact in a prediction
NOTHING: Waypoints = np.zeros((0, 2))


@dataclasses.dataclass(frozen=True)
class _Leg:
    """The rest of the survey of a robot."""

    robot: Robot
    entry: Waypoints  # its position, or the first point inside the area
    left: float  # distance left at the entry, m
    to_end: Waypoints  # the shortest way from there to the end
    has_time: bool  # whether the budget allows more than the way to the end


class Mission:
    """A survey of an area with a budget of distance, for robots or for a person who drives.

    The belief is a Gaussian process of the standardised values with a Matern 5/2 kernel. Numbers are in
    float64, whatever the settings of JAX. Once its programs are compiled, a plan compiles nothing until the
    measurements outgrow the capacity, which doubles then. That of one robot is enough from the first on for a
    measurement at every `spacing` of the budget, up to 256.

    Attributes:
        area: Area to survey.
        robots: Position, distance left, end and last plan of each robot.
        separation: Least distance of two robots, m.
        counts: How often input was left out, by reason: `not_finite` or masked, `too_large` (beyond 1e30 in
            magnitude) and `no_data` (such as -9999), values that stand for missing data, `far_off` (a
            position), `duplicate`, `bad_pose`; `time_backwards`, for measurements that are kept; and
            `tight_turns`, plans that go on with the earlier one since no other has turns of the radius.
        measured: The measurements, and the belief that is learned from them.
        goal: What the survey is for.
    """

    def __init__(
        self,
        area: Area,
        budget: float,
        start: Any,
        end: Any = None,
        *,
        spacing: float,
        lengthscale: float | None = None,
        noise_variance: float = 0.01,
        relearn_every: int | None = None,
        options: RouteOptions | None = None,
        seed: int = 0,
        goal: str | Area = "map",
        robots: int = 1,
        separation: float = 0.0,
    ):
        """Prepare a mission.

        Args:
            area: Area to survey, m.
            budget: Distance that each robot may drive, m.
            start: First position, m; of several robots, one for all or a list with one for each.
            end: Last position, or positions, m; anywhere by default.
            spacing: Distance between two measurements, m.
            lengthscale: Lengthscale of the field before it is learned, m; by default a sixth of the area's
                longer side.
            noise_variance: Variance of the noise before it is learned, as a share of the values' variance.
            relearn_every: Number of measurements after which the hyper-parameters are learned anew; None for
                on request only.
            options: Options of the optimiser of routes; by default `OPTIONS`, with less work than those of a
                single plan. Goals that depend on values have none: their routes are searched for.
            seed: Seed of the tours and of the search for hyper-parameters.
            goal: `"map"`, `"hotspots"` for the highest place, `"threshold=V"` for the places above a value,
                or the part of the area that counts in a map. Without a measurement, the first plan is for a
                map.
            robots: Number of robots, 1 to 4.
            separation: Least distance of two robots at equal times, m, if all begin a plan at once and drive
                equally fast; but for twice as many metres from a common start or to a common end.

        Raises:
            ValueError: A number is out of range, the start or the end is not a position in the area, the
                budget does not reach from the start to the end, or the goal is unknown or out of the area.
        """
        if not isinstance(area, Area):
            raise ValueError(f"area: got {area!r:.60}; allowed: an Area, such as bojax.read_place(FILE).area")
        if robots not in range(1, MOST_ROBOTS + 1):
            raise ValueError(f"robots: got {robots}; allowed: 1 to {MOST_ROBOTS}")
        robots = int(robots)  # 2.0 is in the range, too
        apart = numbers("separation", separation, ">= 0")
        if apart.ndim or not (np.isfinite(apart) and apart >= 0):
            raise ValueError(f"separation: got {separation}; allowed: >= 0")
        separation = float(apart)
        if not (isinstance(seed, int | np.integer) and 0 <= seed < 2**63):
            raise ValueError(f"seed: got {seed}; allowed: an integer >= 0 and < 2^63")
        if not (options is None or isinstance(options, RouteOptions)):
            raise ValueError(f"options: got {options!r:.60}; allowed: RouteOptions")
        starts = positions("start", start, robots)
        ends = [None] * robots if end is None else positions("end", end, robots)
        budget = above_zero("budget", budget, "m")
        self._prepare(area, [Robot(at, budget, to) for at, to in zip(starts, ends, strict=True)], options)
        if budget > (most := MOST_LINES * self._size):
            longest = f"{most:g} m, that of {MOST_LINES:,} lines across the area"
            raise ValueError(f"budget: got {budget:g} m; allowed: at most {longest}")
        self.separation, self.seed = separation, int(seed)
        self.spacing = above_zero("spacing", spacing, "m")
        lengthscale = self._size / 6.0 if lengthscale is None else above_zero("lengthscale", lengthscale, "m")
        # Plans of a team take too long with room for all that it will measure.
        expected = int(min(MOST_EXACT, budget / self.spacing)) if robots == 1 else 0
        noise_variance = above_zero("noise_variance", noise_variance)
        self.measured = Measurements((lengthscale, 1.0, noise_variance), expected)
        if relearn_every is not None and above_zero("relearn_every", relearn_every) % 1:
            raise ValueError(f"relearn_every: got {relearn_every}; allowed: a whole number > 0")
        self.relearn_every = relearn_every
        self.goal = goal_of(goal)
        if self.goal.region is not None:
            counted_points(area, self.goal.region, NUM_GRID)  # or refuse a region elsewhere
        self._check_ways()
        if robots == 1 and separation > 0:
            warnings.warn(f"separation: got {separation:g} m, which one robot does not use", stacklevel=2)

    def _prepare(self, area: Area, robots: list[Robot], options: RouteOptions | None) -> None:
        """Begin without a measurement, with robots that may be anywhere."""
        self._size = longer_side(area.bounds)
        self.area, self.robots, self.separation = area, robots, 0.0
        self.options = OPTIONS if options is None else options
        self.relearn_every, self.seed = None, 0
        self.counts: Counter[str] = Counter()
        self._plans = 0

    def _check_ways(self) -> None:
        """Refuse ends outside the area, and a budget that is less than the shortest way between them.

        Later, a robot may be anywhere, and its budget may be used.

        Raises:
            ValueError: An end of a robot is outside, or the budget is too small.
        """
        for robot in self.robots:
            for name, point in (("start", robot.position), ("end", robot.end)):
                if point is not None:
                    check_inside(self.area, point, name)
            if robot.end is not None:
                shortest = length_of(self._way(robot.position, robot.end))
                if shortest > robot.remaining * (1.0 + ROUNDING):
                    raise too_small(robot.remaining, shortest)

    @property
    def num_measurements(self) -> int:
        """Measurements in the belief."""
        return len(self.measured)

    @property
    def hyperparameters(self) -> tuple[float, float, float]:
        """Lengthscale (m), variance and noise variance, both of standardised values."""
        return self.measured.hyperparameters

    @property
    def position(self) -> Waypoints:
        """Where the robot is, m; of several, the first."""
        return self.robots[0].position

    @property
    def remaining(self) -> float:
        """Distance left, m; of several robots, the first one's."""
        return self.robots[0].remaining

    @property
    def route(self) -> Route | None:
        """The last plan; of several robots, the first one's."""
        return self.robots[0].route

    def plan(self) -> Any:
        """The next waypoints `[W, 2]`, m, to the end of the budget; none if the budget is used.

        If the budget does not allow more than the way to the fixed end, this is the plan. From a position
        outside the area, the route leads to the nearest point inside first. Several robots have a list with
        the waypoints of each, planned together; one that has reached its end is in nobody's way.

        Raises:
            ValueError: No routes are found that stay in the area and keep the separation.
        """
        legs = [self._leg(robot) for robot in self.robots]
        going = [leg for leg in legs if leg.has_time]
        returning = [leg.to_end for leg in legs if not leg.has_time and length_of(leg.to_end) > 0.0]
        if going:
            self._plans += 1
            plan = self._searched if self.goal.needs_values else self._descended
            with jax.enable_x64(True):
                routes = plan(going, returning)
            for leg, route in zip(going, routes, strict=True):
                leg.robot.route = route
        plans = [self._waypoints(leg) for leg in legs]
        return plans[0] if len(plans) == 1 else plans

    def _leg(self, robot: Robot) -> _Leg:
        entry = self._entry(robot.position)
        left = robot.remaining - float(np.linalg.norm(entry - robot.position))
        to_end = self._way(entry, robot.end)
        has_time = left > max(self.spacing, length_of(to_end) * (1.0 + ROUNDING))
        return _Leg(robot, entry, left, to_end, has_time)

    def _waypoints(self, leg: _Leg) -> Waypoints:
        """The plan of a robot without its position."""
        if leg.has_time:
            assert leg.robot.route is not None
            route = leg.robot.route.waypoints
        elif leg.robot.end is None:
            return NOTHING
        else:
            route = leg.to_end
        is_outside = np.any(leg.entry != leg.robot.position)  # the robot comes into the area first
        return route if is_outside else route[1:]

    def _way(self, entry: Waypoints, end: Waypoints | None) -> Waypoints:
        """The shortest way in the area to an end; of no length without one.

        Raises:
            ValueError: No path in the area joins them.
        """
        if end is None:
            return np.stack([entry, entry])
        return Ground.of(self.area, entry).transfers.path(entry, end)

    def _descended(self, legs: list[_Leg], returning: list[Waypoints]) -> list[Route]:
        """Routes of least expected error at the places that count, beside those of returning robots."""
        key = jax.random.fold_in(jax.random.key(self.seed), self._plans)
        try:
            return plan_routes(
                self.posterior(),
                self.area,
                [leg.left for leg in legs],
                [leg.entry for leg in legs],
                [leg.robot.end for leg in legs],
                self._guesses(legs),
                key,
                spacing=self.spacing,
                target=self.goal.region,
                separation=self.separation,
                others=returning,
                options=self._options,
            )
        except ValueError:
            # From where a robot is now, it may not turn widely enough: it goes on with its plan.
            rests = [rest_of(route.waypoints, leg.entry) for leg in legs if (route := leg.robot.route)]
            if not self.options.turning_radius or len(rests) < len(legs):
                raise
            self.counts["tight_turns"] += 1
            return [Route(rest, length_of(rest), np.nan, "earlier plan", {}) for rest in rests]

    def _searched(self, legs: list[_Leg], returning: list[Waypoints]) -> list[Route]:
        """Routes of least loss of a goal that depends on values; of a map without any.

        Each robot's route is searched for given those of the others: new ones of the robots before it, and
        the rests of the earlier plans of those after it, so that its own rest can still be driven.
        """
        goal = Goal()
        if self.num_measurements:
            threshold = self.measured.standardised(self.goal.threshold)
            goal = dataclasses.replace(self.goal, threshold=threshold)
        routes: list[Route] = []
        rests = [self._earlier(leg) for leg in legs]
        for number, leg in enumerate(legs):
            later = [rest for rest in rests[number + 1 :] if rest is not None]
            ground = Ground.of(self.area, leg.entry)
            search = Search(
                self.posterior(),
                to_area(ground.shape),
                leg.left,
                leg.entry,
                leg.robot.end,
                goal,
                spacing=self.spacing,
                ways=ground.transfers,
                random=np.random.default_rng([self.seed, self._plans, *([number] if number else [])]),
                others=[*returning, *(route.waypoints for route in routes), *later],
                separation=self.separation,
            )
            routes.append(search.route(rests[number]))
        return routes

    @property
    def _options(self) -> RouteOptions:
        """The options of a plan.

        Beyond `MOST_EXACT`, measurements leave few kernels plausible but the given one. Without the others,
        and with an earlier plan, half the work is enough.
        """
        if self.num_measurements <= MOST_EXACT:
            return self.options
        restarts, steps = (max(2, each // 2) for each in (self.options.restarts, self.options.steps))
        return dataclasses.replace(self.options, models=1, restarts=restarts, steps=steps)

    def observe(
        self,
        points: Any,
        values: Any,
        pose: Any = None,
        times: Any = None,
        robot: int | None = None,
        *,
        driven: bool = True,
    ) -> int:
        """Take measurements of a robot into the belief, and move it.

        The distance driven, along the points to the pose, is taken from the budget; a point that was only
        passed has the value NaN. What cannot be used is left out and counted in `counts`.

        Args:
            points: Positions of any number of measurements, in the order of driving, `[S, 2]`, m.
            values: Measured values `[S]`; NaN, a mask of NumPy or a marker as in files for no data.
            pose: Position of the robot (further numbers, as a heading, are ignored); by default, the last
                measurement.
            times: Times of the measurements, only to count those that run backwards.
            robot: Index of the robot; of several, it must be given.
            driven: Whether the robot drove there. Measurements of an earlier visit, or of others, cost
                nothing and move no robot; their pose and times are ignored.

        Returns:
            Number of measurements taken.

        Raises:
            ValueError: The points are not rows of x and y, there are not as many values, or times, as points,
                one of them is not a number, or there is no such robot. Then nothing has changed.
        """
        if not driven:
            pose = times = None
        if robot is None and (len(self.robots) == 1 or not driven):
            robot = 0
        if robot is None or robot not in range(len(self.robots)):
            raise ValueError(f"robot: got {robot}; allowed: 0 to {len(self.robots) - 1}")
        its = self.robots[int(robot)]
        points = rows("points", points)
        values = numbers("values", values).reshape(-1)
        pose = None if pose is None else numbers("pose", pose, "x and y in metres").reshape(-1)[:2]
        if len(points) != len(values):
            raise ValueError(f"values: got {len(values)}; allowed: {len(points)}, one for each point")
        if times is not None:
            times = numbers("times", times).reshape(-1)
            if len(times) != len(points):
                raise ValueError(f"times: got {len(times)}; allowed: {len(points)}, one for each point")
            self.counts["time_backwards"] += int(np.sum(np.diff(np.append(its.time, times)) < 0.0))
            its.time = max(its.time, *times.tolist()) if len(times) else its.time
        is_far = ~self._is_near(points)
        if pose is not None and not (len(pose) == 2 and self._is_near(pose)):
            self.counts["bad_pose"] += 1
            pose = None
        if driven:
            its.drive(points[~is_far], pose)
        taken = self.measured.take(points, values, is_far, self.counts)
        every = self.relearn_every
        if every is not None and self.num_measurements - self.measured.learned_at >= max(every, LEAST_DATA):
            self.relearn()
        return taken

    def relearn(self) -> None:
        """Standardise the values, and learn the hyper-parameters from them by their evidence.

        Each has a log-normal prior about its first value, and the lengthscale stays between the spacing and
        twice the size of the area. With fewer than `LEAST_DATA` measurements, nothing changes.
        """
        self.measured.relearn(self.seed, self.spacing, 2.0 * self._size)

    def posterior(self) -> GaussianProcess:
        """The belief about the standardised values that a plan is made from.

        It has room for a power of two of them or, beyond `MOST_EXACT`, is a `sparse_posterior`.
        """
        return self.measured.belief(MOST_EXACT)

    def predict(self, points: Any, most: int = MOST_MAPPED) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the field at points `[M, 2]`, in the units of the values.

        Both are NaN at a point that is not finite. Up to `most` measurements they are exact; of more, the
        belief is summarised at as many points.

        Raises:
            ValueError: The points are not rows of x and y.
        """
        points = rows("points", points)
        # At a distance that is not finite, the kernel is 1: such a point would be known as a measured one.
        is_finite = np.isfinite(points).all(axis=1)
        mean, deviation = self.measured.predict(np.where(is_finite[:, None], points, 0.0), most)
        return np.where(is_finite, mean, np.nan), np.where(is_finite, deviation, np.nan)

    def save(self, path: str | Path) -> None:
        """Write the mission to a file, which is replaced at once or not at all."""
        write_mission(vars(self), Path(path))

    @classmethod
    def load(cls, path: str | Path) -> "Mission":
        """The mission in a file that `save` wrote.

        Raises:
            ValueError: The file is not one.
            FileNotFoundError: There is no such file.
        """
        arguments, attributes = read_mission(path)
        mission = cls.__new__(cls)  # unlike a new one, it may have left the area or used its budget
        mission._prepare(*arguments)
        for name, value in attributes.items():
            setattr(mission, name, value)
        return mission

    def _is_near(self, points: Waypoints) -> np.ndarray:
        """Whether points are finite and within `FAR` sizes of the bounds."""
        low, high = np.array(self.area.bounds).reshape(2, 2)
        beyond = np.maximum(low - points, points - high)
        return np.all(beyond <= FAR * self._size, axis=-1)  # False for NaN

    def _entry(self, position: Waypoints) -> Waypoints:
        """A position, or the nearest of the grid's points if it lies outside the area."""
        if self.area.distances(position[None])[0] >= 0.0:
            return position
        points = spread_points(self.area, 1200)
        return points[np.argmin(np.linalg.norm(points - position, axis=1))]

    def _earlier(self, leg: _Leg) -> Waypoints | None:
        """The rest of the earlier plan, with turns of the radius if there is one, if it stays in the area."""
        route = leg.robot.route
        rest = None if route is None else rest_of(route.waypoints, leg.entry)
        turned = None if rest is None else drivable(rest, self.options.turning_radius)
        return turned if turned is not None and stays_inside(turned, self.area) else None

    def _guesses(self, legs: list[_Leg]) -> dict[str, Sequence[Waypoints]]:
        """The rest of the earlier plans or, if one is missing or leaves the area, the best lawnmowers."""
        rests = [rest for leg in legs if (rest := self._earlier(leg)) is not None]
        if len(rests) == len(legs):
            return {"earlier plan": rests}
        ends = [leg.robot.end for leg in legs if leg.robot.end is not None]
        demand = Demand(
            min(leg.left for leg in legs),
            np.array([leg.entry for leg in legs]),
            np.array(ends) if ends else None,
            robots=len(legs),
            turning_radius=self.options.turning_radius,
        )
        try:
            return {**lawnmower_guesses(
                self.posterior(), self.area, self.goal.region, demand, self.spacing, self._options.restarts
            )}  # fmt: skip
        except ValueError:  # without a budget for them
            return {}
