"""Routes that leave the least expected error: all waypoints of many routes descended at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from bojax.models.gaussian_process import GaussianProcess
from bojax.numerics.quasirandom import generalised_golden_ratio
from bojax.surveys.area import Area
from bojax.surveys.descent import Ends, Limits, Models, descend
from bojax.surveys.guesses import parallel_lines, tour
from bojax.surveys.polylines import Waypoints, driven_at, length_of, points_along, with_waypoints

ROUNDING = 1e-9  # share of a length that may be exceeded by rounding
NUM_SAMPLES = 100  # of a route while it is descended; each stands for several measurements, or a part of one
NUM_GRID, NUM_SCORED = 400, 1200  # points at which the error counts in the descent, and in the final choice
DIRECTIONS = 4  # of parallel lines


@dataclass(frozen=True)
class RouteOptions:
    """Options of the optimiser; the numbers of waypoints, routes and steps fix its compiled program.

    Attributes:
        waypoints: Number of waypoints.
        restarts: Number of first guesses that are descended.
        steps: Steps of Adam.
        rate: Largest change of a coordinate in a step, as a share of the length of the area.
        models: Number of plausible beliefs over which the error is averaged; 1 for the given belief alone.
        stretch: Range of their lengthscales, relative to the given ones.
        anisotropy: Largest ratio of the lengthscales of two directions, relative to the given ones.
        turning_radius: Least radius of turns, m; 0 for any. It is a penalty of the descent, not a guarantee.
    """

    waypoints: int = 48
    restarts: int = 8
    steps: int = 200
    rate: float = 0.01
    models: int = 8
    stretch: tuple[float, float] = (0.7, 1.4)
    anisotropy: float = 3.0
    turning_radius: float = 0.0


@dataclass(frozen=True)
class Route:
    """A planned route.

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


def plan_route(
    posterior: GaussianProcess,
    area: Area,
    budget: float,
    start: Any = None,
    end: Any = None,
    first_guesses: Mapping[str, Any] | None = None,
    key: Key[Array, ""] | None = None,
    *,
    spacing: float,
    weight: Any = None,
    target: Area | None = None,
    options: RouteOptions | None = None,
) -> Route:
    """The route of least expected error over an area, with a length of at most the budget.

    The first guesses, parallel lines in several directions and tours are descended. The best of the results
    and of the first guesses themselves is chosen, so that no route is proposed that is expected to be worse
    than a given one.

    Args:
        posterior: Belief about the field, of positions in metres.
        area: Area to survey.
        budget: Maximum length, m.
        start: Fixed start, m; free by default.
        end: Fixed end, m; free by default.
        first_guesses: Waypoints of routes by name, such as a lawnmower's. They are brought to the fixed ends,
            and cut at the budget if the end is free.
        key: Random key of the tours.
        spacing: Distance between two measurements, m.
        weight: Function of points `[M, 2]` that gives their weights in the error; all alike by default.
        target: Part of the area where the error counts; the whole area by default.
        options: Options of the optimiser.

    Raises:
        ValueError: A number is out of range, an end or the target lies outside the area, the budget
            does not reach from start to end, or no candidate stays in the area within the budget.
    """
    options = RouteOptions() if options is None else options
    dtype = posterior.y.dtype
    start, end = (_end(name, at, area) for name, at in (("start", start), ("end", end)))
    _check(budget, spacing, start, end)
    key = jax.random.key(0) if key is None else key
    random = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    given = {name: fitted(guess, budget, start, end) for name, guess in (first_guesses or {}).items()}
    points, scored = (_counting(area, target, number) for number in (NUM_GRID, NUM_SCORED))
    guesses = given | _own_guesses(points, budget, start, end, options.restarts - len(given), random)

    maps = jnp.asarray(plausible_maps(options), dtype)
    descent, final = (_models(posterior, jnp.asarray(grid, dtype), maps, weight) for grid in (points, scored))
    size = _extent(area)
    ends = Ends(*(None if at is None else jnp.asarray(at, dtype) for at in (start, end)))
    distance = jax.tree.map(lambda leaf: leaf.astype(dtype), area.distance_grid(size / 200))
    limits = Limits(distance, *(jnp.asarray(x, dtype) for x in (size / 200, options.turning_radius)))
    first = np.stack([with_waypoints(guess, options.waypoints) for guess in guesses.values()])
    step, rate = (jnp.asarray(x, dtype) for x in (budget / NUM_SAMPLES, options.rate * size))
    routes = descend(
        jnp.asarray(first, dtype),
        ends,
        jnp.asarray(budget, dtype),
        descent,
        limits,
        step,
        NUM_SAMPLES,
        step / spacing,
        options.steps,
        rate,
    )
    found = {f"optimised from {name}": np.asarray(r) for name, r in zip(guesses, routes, strict=True)}
    candidates = {
        name: route
        for name, route in (given | found).items()
        if length_of(route) <= budget * (1.0 + ROUNDING) and stays_inside(route, area)
    }
    if not candidates:
        raise ValueError(
            f"route: none of {len(found)} routes of {budget:g} m stays in the area; allowed: a larger "
            f"budget, or a first guess that does"
        )
    return _best(candidates, final, budget, spacing, options.waypoints, dtype)


def stays_inside(route: Waypoints, area: Area) -> bool:
    """Whether the points at every 1/500 of the area's size along a route, and its waypoints, lie inside."""
    number = 2 + int(length_of(route) / _extent(area) * 500)
    return _are_inside(area, np.concatenate([route, with_waypoints(route, len(route) + number)]))


def _are_inside(area: Area, points: Waypoints) -> bool:
    """Whether all points are in the area or, but for rounding, on its border."""
    return bool(np.all(area.distances(points) >= -ROUNDING * _extent(area)))


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
    spacing = _extent(area) / 40
    share = len(area.grid(spacing)) / number
    return area.grid(spacing * share**0.5)


def _counting(area: Area, target: Area | None, number: int) -> Waypoints:
    """About `number` points `[M, 2]` of the area in its target, m."""
    if target is None:
        return spread_points(area, number)
    points = spread_points(target, number)
    points = points[area.contains(points)]
    if not len(points):
        raise ValueError("target: no part of it lies in the area")
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


def _own_guesses(points, budget, start, end, number, random) -> dict[str, Waypoints]:
    """Parallel lines in several directions, then tours; at most `number`."""
    guesses = {}
    for index in range(max(number, 0)):
        if index < DIRECTIONS:
            angle = np.pi * index / DIRECTIONS
            name = f"lines at {np.degrees(angle):.0f} degrees"
            guesses[name] = parallel_lines(points, angle, budget, start, end)
            continue
        # A tour through n points of an area a is about 0.7 sqrt(n a) long.
        size = np.prod(np.ptp(points, axis=0))
        stops = int(np.clip((budget / 0.7) ** 2 / size, 3, 40))
        guesses[f"tour {index - DIRECTIONS + 1}"] = tour(points, stops, start, end, random)
    return guesses


def _best(candidates: dict[str, Waypoints], final: Models, budget, spacing, least, dtype) -> Route:
    """The candidate of least error."""
    number = max(least, *(len(route) for route in candidates.values()))
    together = [jnp.asarray(with_waypoints(route, number), dtype) for route in candidates.values()]
    # Twice as many samples as in the descent: the number is fixed, so that no budget compiles anew.
    step = jnp.asarray(budget / (2 * NUM_SAMPLES), dtype)
    errors = [float(_error(final, route, step, step / spacing)) for route in together]
    order = np.argsort(errors, kind="stable")
    names = list(candidates)
    chosen = names[order[0]]
    route = candidates[chosen]
    scores = {names[index]: errors[index] for index in order}
    return Route(route, length_of(route), scores[chosen], chosen, scores)


@eqx.filter_jit
def _error(models: Models, route: Float[Array, "W 2"], step: Array, samples_per_point: Array) -> Array:
    return models.mean_error(route, step, 2 * NUM_SAMPLES, samples_per_point)


@eqx.filter_jit
def _beliefs(posterior: GaussianProcess, grid: Array, weights: Array, maps: Array) -> Models:
    return Models.of(posterior, grid, weights, maps)


def _models(posterior: GaussianProcess, grid: Array, maps: Array, weight: Any) -> Models:
    weights = np.ones(len(grid)) if weight is None else np.asarray(weight(np.asarray(grid)), float)
    if weights.shape != (len(grid),) or not (np.all(weights >= 0.0) and np.sum(weights) > 0.0):
        raise ValueError("weight: allowed: numbers >= 0, one for each point, with a sum > 0")
    return _beliefs(posterior, grid, jnp.asarray(weights, grid.dtype), maps)


def _extent(area: Area) -> float:
    """The longer side of the area's bounds, m."""
    x_min, y_min, x_max, y_max = area.bounds
    return max(x_max - x_min, y_max - y_min)


def _end(name: str, at: Any, area: Area) -> Waypoints | None:
    if at is None:
        return None
    point = np.asarray(at, float)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"{name}: got {at}; allowed: x and y in metres")
    if not _are_inside(area, point[None]):
        raise ValueError(f"{name}: ({point[0]:g}, {point[1]:g}) lies outside the area, or in a hole of it")
    return point


def _check(budget: float, spacing: float, start: Waypoints | None, end: Waypoints | None) -> None:
    for name, value in (("budget", budget), ("spacing", spacing)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: got {value:g}; allowed: > 0 m")
    if spacing > budget:
        raise ValueError(f"spacing: got {spacing:g}; allowed: at most the budget, {budget:g} m")
    if start is not None and end is not None:
        least = float(np.linalg.norm(end - start))
        if budget < least:
            raise ValueError(f"budget: got {budget:g} m; allowed: at least {least:g}, from start to end")
