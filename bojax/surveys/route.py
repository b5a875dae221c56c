"""Routes that leave the least expected error: all waypoints of many routes descended at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from bojax.areas.area import Area, longer_side
from bojax.areas.distance_grid import DistanceGrid
from bojax.models.gaussian_process import GaussianProcess
from bojax.numerics.quasirandom import generalised_golden_ratio
from bojax.surveys.descent import Ends, Limits, Models, descend
from bojax.surveys.guesses import parallel_lines, tour
from bojax.surveys.polylines import Waypoints, driven_at, length_of, points_along, with_waypoints
from bojax.surveys.team import keep_separation, split_points
from bojax.surveys.turns import drivable

MARGIN = 1.05  # of the turning radius while routes are descended, as limits are penalties there
ROUNDING = 1e-9  # share of a length that may be exceeded by rounding
NUM_SAMPLES = 100  # of a route while it is descended; each stands for several measurements, or a part of one
NUM_GRID, NUM_SCORED = 400, 1200  # points at which the error counts in the descent, and in the final choice
DIRECTIONS = 4  # of parallel lines

_beliefs, _error = eqx.filter_jit(Models.of), eqx.filter_jit(Models.mean_error)


@dataclass(frozen=True)
class RouteOptions:
    """Options of the optimiser; the numbers of waypoints, routes and steps fix its compiled program.

    Attributes:
        waypoints: Number of waypoints.
        restarts: Number of first guesses that are descended.
        steps: Steps of Adam.
        rate: Largest change of a coordinate in a step, as a share of the length of the area.
        models: Number of plausible beliefs over which the error is averaged; 1 for the given belief alone.
        stretch: Range of their lengthscales, relative to the given ones. With a longer upper end, places far
            from the route count more: it leaves no large gaps, and covers less densely.
        anisotropy: Largest ratio of the lengthscales of two directions, relative to the given ones.
        turning_radius: Least radius of turns, m; 0 for any.
    """

    waypoints: int = 48
    restarts: int = 8
    steps: int = 200
    rate: float = 0.01
    models: int = 8
    stretch: tuple[float, float] = (0.7, 1.4)
    anisotropy: float = 3.0
    turning_radius: float = 0.0

    def __post_init__(self) -> None:
        for name, least in (("waypoints", 2), ("restarts", 1), ("steps", 1), ("models", 1)):
            number = getattr(self, name)
            if not (isinstance(number, int | np.integer) and number >= least):
                raise ValueError(f"options: got {number} {name}; allowed: an integer >= {least}")


@dataclass(frozen=True)
class Route:
    """A planned route of a robot; what is said of its error holds for those of all robots together.

    Attributes:
        waypoints: Waypoints, start and end included, m.
        length: Length along straight pieces, m; at most the budget.
        error: Root mean squared error over the area that is expected after the route, averaged over the
            plausible beliefs.
        chosen: Name of the candidate: a first guess as given, or "optimised from ...".
        candidates: Error of every candidate that keeps the budget and stays in the area, best first.
    """

    waypoints: Waypoints
    length: float
    error: float
    chosen: str
    candidates: dict[str, float]


@dataclass
class Robot:
    """What a mission knows of a robot."""

    position: Waypoints  # where it is, m
    remaining: float  # distance left, m
    end: Waypoints | None = None  # its last position, m; None for anywhere
    route: Route | None = None  # its last plan
    time: float = -np.inf  # latest time of its measurements

    def drive(self, points: Waypoints, pose: Waypoints | None) -> None:
        """Go along points `[N, 2]` to a pose, if there is one, and take the length from what is left."""
        way = [self.position, *points] + ([] if pose is None else [pose])
        self.remaining = max(self.remaining - length_of(np.array(way)), 0.0)
        self.position = np.array(way[-1])


def plan_routes(
    posterior: GaussianProcess,
    area: Area,
    budget: float | Sequence[float],
    starts: Sequence[Any],
    ends: Sequence[Any],
    first_guesses: Mapping[str, Sequence[Any]] | None = None,
    key: Key[Array, ""] | None = None,
    *,
    spacing: float,
    weight: Any = None,
    target: Area | None = None,
    separation: float = 0.0,
    others: Sequence[Waypoints] = (),
    options: RouteOptions | None = None,
) -> list[Route]:
    """The routes of one or several robots that leave the least expected error over an area together.

    The first guesses, parallel lines in several directions and tours are descended. The best of the results
    and of the first guesses themselves is chosen, so that no route is proposed that is expected to be worse
    than a given one.

    Args:
        posterior: Belief about the field, of positions in metres.
        area: Area to survey.
        budget: Maximum length of all routes, or of each robot's, m: enough for the way between fixed ends.
        starts: Fixed start of each robot in the area, m; None for a free one.
        ends: Fixed end of each robot in the area, m; None for a free one.
        first_guesses: Waypoints of the routes of all robots by name, such as lawnmowers. They are brought to
            the fixed ends, and cut at the budget if the end is free.
        key: Random key of the tours.
        spacing: Distance between two measurements, m.
        weight: Function of points `[M, 2]` that gives their weights in the error; all alike by default.
        target: Part of the area where the error counts; the whole area by default.
        separation: Least distance of two robots that have driven equally far, m, as of `least_distance`:
            robots may share a mooring.
        others: Routes of robots that are on their way already, from which the separation is kept.
        options: Options of the optimiser.

    Raises:
        ValueError: The target lies outside the area, or no candidate stays in the area within the budget or
            keeps the separation.
    """
    options = RouteOptions() if options is None else options
    dtype = posterior.y.dtype
    starts, ends = (
        [None if at is None else np.asarray(at, float) for at in points] for points in (starts, ends)
    )
    budgets = np.broadcast_to(budget, len(starts)).tolist()
    key = jax.random.key(0) if key is None else key
    random = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    given = {
        name: [
            fitted(each, own, start, end)
            for each, own, start, end in zip(guess, budgets, starts, ends, strict=True)
        ]
        for name, guess in (first_guesses or {}).items()
    }
    points, scored = (counted_points(area, target, number) for number in (NUM_GRID, NUM_SCORED))
    guesses = given | _own_guesses(points, budgets, starts, ends, options.restarts - len(given), random)

    maps = jnp.asarray(plausible_maps(options), dtype)
    descent, final = (_models(posterior, jnp.asarray(grid, dtype), maps, weight) for grid in (points, scored))
    size, number = longer_side(area.bounds), samples_of_each(len(starts))
    fixed = [
        Ends(*(None if at is None else jnp.asarray(at, dtype) for at in pair))
        for pair in zip(starts, ends, strict=True)
    ]
    distance = jax.tree.map(lambda leaf: leaf.astype(dtype), DistanceGrid.of(area, size / 200))
    clearance, radius, apart = (
        jnp.asarray(x, dtype) for x in (size / 200, MARGIN * options.turning_radius, separation)
    )
    limits = Limits(distance, clearance, radius if options.turning_radius else None, apart)
    # The waypoints of turns along arcs would leave few for the lines between them.
    evenly = options.turning_radius > 0.0
    first = np.stack(
        [[with_waypoints(each, options.waypoints, evenly) for each in guess] for guess in guesses.values()]
    )
    step, rate = (jnp.asarray(x, dtype) for x in (max(budgets) / number, options.rate * size))
    routes = descend(
        jnp.asarray(first, dtype),
        fixed,
        jnp.asarray(budgets[0] if len(budgets) == 1 else budget, dtype),
        descent,
        limits,
        step,
        number,
        step / spacing,
        options.steps,
        rate,
    )
    found = {f"optimised from {name}": list(np.asarray(r)) for name, r in zip(guesses, routes, strict=True)}
    candidates = {}
    for name, together in (given | found).items():
        turned = [drivable(each, options.turning_radius) for each in together]
        driven = [
            each
            for each, own in zip(turned, budgets, strict=True)
            if each is not None and length_of(each) <= own * (1.0 + ROUNDING) and stays_inside(each, area)
        ]
        if len(driven) == len(together):
            candidates[name] = driven
    if not candidates:
        turns = f" with turns of {options.turning_radius:g} m" if options.turning_radius else ""
        raise ValueError(
            f"route: none of {len(found)} routes of {max(budgets):g} m{turns} stays in the area; allowed: "
            f"{'a smaller turning radius, ' if turns else ''}a larger budget, or a first guess that does"
        )
    if separation > 0.0:
        candidates = {
            name: each for name, each in candidates.items() if keep_separation(each, separation, others)
        }
    if not candidates:
        raise ValueError(
            f"separation: got {separation:g} m, which no candidate keeps; allowed: a smaller one"
        )
    return _best(candidates, final, max(budgets), spacing, options.waypoints, dtype)


def samples_of_each(num_robots: int) -> int:
    """Number of samples of each robot while routes are descended: the time grows with the cube of all."""
    return int(NUM_SAMPLES / num_robots**0.5)


def stays_inside(route: Waypoints, area: Area) -> bool:
    """Whether the points at every 1/500 of the area's size along a route, and its waypoints, lie inside."""
    number = 2 + int(length_of(route) / longer_side(area.bounds) * 500)
    points = np.concatenate([route, with_waypoints(route, len(route) + number)])
    outside = points[~area.contains(points)]  # distances take longer where a border has many edges
    return bool(np.all(area.distances(outside) >= -ROUNDING * longer_side(area.bounds)))


def fitted(guess: Any, budget: float, start: Waypoints | None, end: Waypoints | None) -> Waypoints:
    """A route brought to the fixed ends, and cut at the budget if its end is free."""
    route = np.asarray(guess, float)
    if start is not None and not np.allclose(route[0], start):
        route = np.concatenate([start[None], route])
    if end is not None:
        return route if np.allclose(route[-1], end) else np.concatenate([route, end[None]])
    driven = driven_at(route)
    if driven[-1] <= budget:
        return route
    return np.concatenate([route[driven < budget], points_along(route, np.array([budget]))])


def spread_points(area: Area, number: int) -> Waypoints:
    """About `number` points `[M, 2]` on a square grid in the area, m."""
    spacing = longer_side(area.bounds) / 40
    share = len(area.grid(spacing)) / number
    return area.grid(spacing * share**0.5)


def counted_points(area: Area, target: Area | None, number: int) -> Waypoints:
    """About `number` points `[M, 2]` of the area in its target, m.

    Raises:
        ValueError: No point of the target is in the area.
    """
    if target is None:
        return spread_points(area, number)
    points = spread_points(target, number)
    points = points[area.contains(points)]
    if not len(points):
        raise ValueError("goal: no part of its region lies in the area")
    return points


def plausible_maps(options: RouteOptions) -> np.ndarray:
    """Linear maps `[Q, 2, 2]` that stretch the plane by plausible factors in rotated directions.

    The factors and directions fill their ranges evenly: the additive recurrence of `shifted_kronecker`.
    """
    if options.models == 1:
        return np.eye(2)[None]
    ratio = generalised_golden_ratio(3)
    shares = np.arange(1, options.models + 1)[:, None] * ratio ** -np.arange(1.0, 4.0) % 1.0
    low, high = options.stretch
    maps = []
    for size, flatness, direction in shares:
        stretch = low * (high / low) ** size
        ratio = options.anisotropy ** (flatness - 0.5)
        c, s = np.cos(np.pi * direction), np.sin(np.pi * direction)
        turn = np.array([[c, s], [-s, c]])
        maps.append(turn.T @ np.diag([1.0 / (stretch * ratio), ratio / stretch]) @ turn)
    return np.array(maps)


def _own_guesses(points, budgets, starts, ends, number, random) -> dict[str, list[Waypoints]]:
    """Parallel lines in several directions, then tours, in a strip for each robot; at most `number`."""
    guesses = {}
    for index in range(max(number, 0)):
        angle = np.pi * (index % DIRECTIONS) / DIRECTIONS
        strips = split_points(points, len(starts), angle, starts, ends)
        together = list(zip(strips, budgets, starts, ends, strict=True))
        if index < DIRECTIONS:
            name = f"lines at {180 * index / DIRECTIONS:g}\N{DEGREE SIGN}"
            guesses[name] = [parallel_lines(strip, angle, own, at, to) for strip, own, at, to in together]
            continue
        name = f"tour {index - DIRECTIONS + 1}"
        guesses[name] = [tour(strip, _stops(strip, own), at, to, random) for strip, own, at, to in together]
    return guesses


def _stops(points: Waypoints, budget: float) -> int:
    # A tour through n points of an area a is about 0.7 sqrt(n a) long.
    size = np.prod(np.ptp(points, axis=0))
    return int(np.clip((budget / 0.7) ** 2 / size, 3, 40))


def _best(
    candidates: dict[str, list[Waypoints]], final: Models, budget, spacing, least, dtype
) -> list[Route]:
    """The candidate of least error."""
    # Routes of at most `least` waypoints share a program; longer ones are rounded up, so that few differ.
    stacked = []
    for together in candidates.values():
        longest = max(map(len, together))
        number = least if longest <= least else 32 * -(-longest // 32)
        stacked.append(jnp.asarray(np.stack([with_waypoints(route, number) for route in together]), dtype))
    # Twice as many samples as in the descent: the number is fixed, so that no budget compiles anew.
    samples = 2 * samples_of_each(len(stacked[0]))
    step = jnp.asarray(budget / samples, dtype)
    errors = [float(_error(final, routes, step, samples, step / spacing)) for routes in stacked]
    order = np.argsort(errors, kind="stable")
    names = list(candidates)
    chosen = names[order[0]]
    scores = {names[index]: errors[index] for index in order}
    return [Route(each, length_of(each), scores[chosen], chosen, scores) for each in candidates[chosen]]


def _models(posterior: GaussianProcess, grid: Array, maps: Array, weight: Any) -> Models:
    weights = np.ones(len(grid)) if weight is None else np.asarray(weight(np.asarray(grid)), float)
    return _beliefs(posterior, grid, jnp.asarray(weights, grid.dtype), maps)
