"""Choosing the route of a survey: candidates, and the error that the model expects after each."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import shapely
from scipy.spatial import KDTree

from bojax.areas.area import Area
from bojax.areas.shapes import to_shape
from bojax.models.gaussian_process import GaussianProcess
from bojax.surveys.goals import Goal
from bojax.surveys.information import PointErrors, left_by
from bojax.surveys.lawnmower import DIRECTIONS, Ground, TurnsTooTight, check_budget
from bojax.surveys.model import FieldModel
from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import NUM_GRID, RouteOptions, counted_points, plan_routes
from bojax.surveys.team import keep_separation, team_lawnmowers
from bojax.surveys.turns import Turned

GRID_POINTS = 1500
"""Number of points at which the error counts."""

MOST_SAMPLES = 600
"""Number of samples of the longest candidate; each stands for several measurements if there are more."""

NUM_GUESSES = 4
"""Number of lawnmowers that the optimiser begins with, beside its own first guesses."""

MOST_WAYPOINTS = 128
"""Largest number of waypoints of an optimised route."""

LONGEST = 3.0
"""Longest lengthscale that an optimised route counts as plausible, relative to the model's."""

_errors_of = eqx.filter_jit(PointErrors.of)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A route, and the error that it is expected to leave."""

    method: str  # `lawnmower` or `route`
    detail: str  # what distinguishes it from others of its method
    routes: tuple[np.ndarray, ...]  # waypoints `[W, 2]` of each robot, m
    distances: np.ndarray  # distances from the start, which all robots drive at once, m; 0 first
    # Mean standard deviation, weighted by the goal, after the measurements up to each distance
    errors: np.ndarray
    # Of a lawnmower, the largest share of a robot's waypoints that turns leave no room for
    left_out: float = 0.0

    @property
    def name(self) -> str:
        """Its method and detail."""
        return f"{self.method}, {self.detail}" if self.detail else self.method

    @property
    def length(self) -> float:
        """Length of the longest of the routes, m."""
        return max(map(length_of, self.routes))

    @property
    def error(self) -> float:
        """The error at its end."""
        return float(self.errors[-1])


@dataclass(frozen=True)
class Demand:
    """What is asked of a route."""

    # Maximum length of each route, m; None to cover the area with lines at `spacing`
    budget: float | None = None
    start: np.ndarray | None = None  # first point, m, of all robots `[2]` or of each `[K, 2]`; free if None
    end: np.ndarray | None = None  # last point, m, of all robots or of each; free if None
    # Least distance between two lines, m; None for none with a budget, and for the lengthscale of the model
    # without
    spacing: float | None = None
    sampling: float | None = None  # distance between two measurements, m; None for a fifth of the lengthscale
    goal: Goal = field(default_factory=Goal)  # what the survey is for
    robots: int = 1  # number of robots
    # Least distance of two robots that have driven equally far, m, as of `plan_routes`
    separation: float = 0.0
    turning_radius: float = 0.0  # least radius of turns, m; 0 for turns on the spot

    @property
    def starts(self) -> list[np.ndarray | None]:
        """The start of each robot."""
        return _of_each(self.start, self.robots)

    @property
    def ends(self) -> list[np.ndarray | None]:
        """The end of each robot."""
        return _of_each(self.end, self.robots)


@dataclass(frozen=True, eq=False)
class Survey:
    """A planned survey."""

    candidates: tuple[Candidate, ...]  # all routes, the one that leaves the least error first
    grid: np.ndarray  # points at which the error counts, `[M, 2]`, m
    grid_spacing: float  # distance between two of them, m
    weights: np.ndarray  # their weights in the error
    before: np.ndarray  # standard deviation at each before the survey
    after: np.ndarray  # the same after the first candidate
    sampling: float  # distance between two measurements, m
    lines: float | None  # distance between two lines, m, if there is no budget
    share: float  # share of the area that is surveyed: the part with the start, or else the largest part

    @property
    def chosen(self) -> Candidate:
        """The proposed route."""
        return self.candidates[0]

    @property
    def lawnmower(self) -> Candidate:
        """The best lawnmower."""
        return next(each for each in self.candidates if each.method == "lawnmower")

    @property
    def missed(self) -> float:
        """Share of the area that is farther from the proposed route than two lines are from each other."""
        assert self.lines is not None
        step = self.grid_spacing / 4.0
        routes = [
            points_along(each, np.arange(0.0, length_of(each) + step, step)) for each in self.chosen.routes
        ]
        distance, _ = KDTree(np.concatenate(routes)).query(self.grid)
        return float(np.mean(distance > self.lines))


def plan_survey(area: Area, model: FieldModel, demand: Demand, optimises: bool = True) -> Survey:
    """The candidate after which the model expects the least error, with all others.

    Candidates are lawnmowers in all directions and, with a budget, the route that `plan_routes` finds from
    the best of them.

    Of an area in several parts, the one with the start or else the largest is surveyed. `optimises` says
    whether to look for a better route than the lawnmowers.

    Raises:
        ValueError: The ends cannot be reached within the budget, or are not in the area, or no lawnmower
            has turns of the radius.
    """
    known = [end for end in (*demand.starts, *demand.ends) if end is not None]
    ground = Ground.of(area, known[0] if known else None, demand.turning_radius)
    if not all(shapely.dwithin(ground.shape, shapely.Point(end), 1e-6) for end in known):
        raise ValueError("the starts and ends lie in several parts of the area; allowed: points of one part")
    if demand.budget is not None:
        for start, end in zip(demand.starts, demand.ends, strict=True):
            check_budget(ground, demand.budget, start, end)
    part, goal = Area(tuple(ground.rings)), demand.goal
    counting = ground if goal.region is None else ground_within(ground, goal.region)
    routes, lines = _lawnmowers(counting, model.lengthscale, demand)
    if goal.region is not None:
        routes = [(f"{detail}, over the region", together) for detail, together in routes]
        if demand.budget is not None:
            routes += _lawnmowers(ground, model.lengthscale, demand)[0]
    spacing = math.sqrt(counting.size / GRID_POINTS)
    belief, grid = model.belief(), Area(tuple(counting.rings)).grid(spacing)
    weights = goal.weights(*model.predict(grid))
    longest = max(length_of(each.route) for _, together in routes for each in together)
    sampling = demand.sampling or model.lengthscale / 5.0
    errors = _errors_of(belief, jnp.asarray(grid), jnp.asarray(weights))
    # No more than twice the longest lawnmower, or routes that are far shorter than the budget would have no
    # sample.
    reach = longest if demand.budget is None else min(demand.budget, 2.0 * longest)
    outcomes = _Outcomes(errors, sampling, reach, demand.robots)
    found = [outcomes.of_lawnmowers(*each) for each in routes]
    # Without a budget every candidate covers the area: the shortest one is the best. Turns may leave gaps.
    by_length = demand.budget is None and demand.turning_radius == 0.0
    found.sort(key=lambda each: each[0].length if by_length else each[0].error)
    if optimises and demand.budget is not None:
        guesses = [candidate for candidate, _ in found[:NUM_GUESSES]]
        apart = counting.size / (demand.budget * demand.robots)
        if route := _optimised(model, part, demand, guesses, min(sampling, demand.budget), apart):
            found.append(outcomes.of("route", *route))
            found.sort(key=lambda each: each[0].error)
    # Robots that come closer than asked are proposed only if no candidate keeps its distance.
    found.sort(key=lambda each: not keep_separation(each[0].routes, demand.separation))
    return Survey(
        candidates=tuple(candidate for candidate, _ in found),
        grid=grid,
        grid_spacing=spacing,
        weights=weights / weights.mean(),
        before=np.sqrt(np.asarray(outcomes.errors.variance)),
        after=np.sqrt(np.maximum(found[0][1], 0.0)),
        sampling=sampling,
        lines=lines,
        share=ground.size / to_shape(area).area,
    )


def lawnmower_guesses(
    posterior: GaussianProcess,
    area: Area,
    region: Area | None,
    demand: Demand,
    sampling: float,
    number: int,
) -> dict[str, tuple[np.ndarray, ...]]:
    """The lawnmowers that are expected to leave the least error, one of each robot, at most `number` of them.

    They are driven, and errors count, in the part of the area with the first robot's start, and of that in
    the region, if there is one. A measurement is made at every `sampling` metres.

    Raises:
        ValueError: The budget does not reach from the start to the end.
    """
    assert demand.budget is not None
    ground = Ground.of(area, demand.starts[0], demand.turning_radius)
    ground = ground if region is None else ground_within(ground, region)
    errors = _errors_of(posterior, jnp.asarray(counted_points(area, region, NUM_GRID)))
    outcomes = _Outcomes(errors, sampling, demand.budget, demand.robots)
    routes, _ = _lawnmowers(ground, 0.0, demand)
    found = [outcomes.of_lawnmowers(*each)[0] for each in routes]
    return {each.name: each.routes for each in sorted(found, key=lambda each: each.error)[:number]}


def _optimised(
    model: FieldModel,
    area: Area,
    demand: Demand,
    guesses: Sequence[Candidate],
    sampling: float,
    apart: float,
) -> tuple[str, Sequence[np.ndarray]] | None:
    """The routes that `plan_routes` finds, with their origin; None if it prefers one of the guesses.

    `apart` is the distance between parallel lines over the area that use the whole budget, m.
    """
    assert demand.budget is not None
    corners = max(len(route) for guess in guesses for route in guess.routes)
    # Multiples of 16, since each number of waypoints compiles a program of its own.
    waypoints = int(np.clip(16 * math.ceil(corners / 16), 48, MOST_WAYPOINTS))
    options = RouteOptions(waypoints=waypoints, turning_radius=demand.turning_radius)
    # Between lines that are further apart than the lengthscale, nothing is learned, whatever the route,
    # unless the field varies over longer distances: it is for such fields that the gaps are chosen.
    low, high = options.stretch
    longest = float(np.clip(apart / model.lengthscale, high, LONGEST))
    options = dataclasses.replace(options, stretch=(low, longest))
    found = plan_routes(
        model.belief(),
        area,
        demand.budget,
        demand.starts,
        demand.ends,
        {guess.name: guess.routes for guess in guesses},
        spacing=sampling,
        weight=lambda points: demand.goal.weights(*model.predict(points)),
        target=demand.goal.region,
        separation=demand.separation,
        options=options,
    )
    if (chosen := found[0].chosen) in {guess.name for guess in guesses}:
        return None
    return chosen, [route.waypoints for route in found]


def ground_within(ground: Ground, region: Area) -> Ground:
    """The part of the ground in a region, with the transfers of the whole ground.

    Raises:
        ValueError: No part of the region is in the ground.
    """
    shape = shapely.intersection(ground.shape, to_shape(region))
    if shape.area <= 1e-9 * ground.size:
        raise ValueError("region: no part of it is in the part of the area that is surveyed")
    return dataclasses.replace(ground, shape=shape)


class _Outcomes:
    """What the model expects after routes, by one compiled program; `errors` is the belief before."""

    def __init__(self, errors: PointErrors, sampling: float, longest: float, robots: int):
        """Prepare routes of at most `longest` metres with a measurement at every `sampling` metres."""
        self.errors = errors
        self._number = int(min(MOST_SAMPLES // robots, max(1, longest * (1.0 + 1e-9) // sampling)))
        self._step = max(sampling, longest / self._number)
        self._per_sample = self._step / sampling

    def of_lawnmowers(self, detail: str, together: Sequence[Turned]) -> tuple[Candidate, np.ndarray]:
        """As `of`."""
        candidate, variance = self.of("lawnmower", detail, [each.route for each in together])
        left_out = max(each.left_out for each in together)
        return dataclasses.replace(candidate, left_out=left_out), variance

    def of(self, method: str, detail: str, routes: Sequence[np.ndarray]) -> tuple[Candidate, np.ndarray]:
        """The routes of all robots as a candidate, and the variances at the grid after them."""
        distances = self._step * np.arange(1, self._number + 1)
        # Samples of all robots at one distance are neighbours: the curve is cut after each distance.
        lengths = np.array([length_of(route) for route in routes])
        is_taken = distances[:, None] <= lengths * (1.0 + 1e-9)
        samples = np.stack([points_along(route, distances) for route in routes], axis=1).reshape(-1, 2)
        per_sample = jnp.asarray(self._per_sample)
        curve, variance = left_by(
            self.errors, jnp.asarray(samples), jnp.asarray(is_taken.ravel()), per_sample
        )
        taken = int(is_taken.any(axis=1).sum())
        driven = self._step * np.arange(taken + 1)
        errors = np.asarray(curve)[:: len(routes)][: taken + 1]
        candidate = Candidate(method, detail, tuple(routes), driven, errors)
        return candidate, np.asarray(variance)


def _lawnmowers(
    ground: Ground, lengthscale: float, demand: Demand
) -> tuple[list[tuple[str, list[Turned]]], float | None]:
    """Lawnmowers of all robots by direction, and the distance of lines without a budget."""
    lines = None if demand.budget is not None else demand.spacing or lengthscale
    routes, too_tight = [], None
    for index in range(DIRECTIONS):
        angle = math.pi * index / DIRECTIONS
        detail = f"lines at {180 * index / DIRECTIONS:g}\N{DEGREE SIGN}"
        spacing = lines or demand.spacing or 0.0
        try:
            found = team_lawnmowers(
                ground, demand.robots, angle, demand.starts, demand.ends, demand.budget, spacing
            )
        except TurnsTooTight as error:
            too_tight = error
            continue
        routes += [(detail if i == 0 else f"{detail}, cut", together) for i, together in enumerate(found)]
    if not routes and too_tight is not None:
        raise too_tight
    return routes, lines


def _of_each(given: np.ndarray | None, number: int) -> list[np.ndarray | None]:
    """The end of each robot, of one for all or one for each."""
    return [None] * number if given is None else list(np.broadcast_to(given, (number, 2)))
