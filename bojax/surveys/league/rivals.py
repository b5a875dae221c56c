"""Simple routes of the league of surveys: a random one, a myopic one, and lines from a corner."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root_scalar

from bojax.areas.area import Area
from bojax.surveys.information import PointErrors
from bojax.surveys.polylines import length_of, points_along
from bojax.surveys.route import fitted, stays_inside

STEP, HEADINGS = 1.0, 16
"""Length and number of directions of the steps that the myopic route compares."""

LINES = range(2, 13)
"""Numbers of lines among which the route from a corner is chosen."""


def random_route(area: Area, budget: float, start: np.ndarray, seed: int) -> np.ndarray:
    """Straight lines to uniform points of the area that can be reached in it, to the end of the budget."""
    random, points = np.random.default_rng(seed), area.grid(0.1)
    route = start[None]
    while length_of(route) < budget:
        following = points[random.integers(len(points))]
        if stays_inside(np.stack([route[-1], following]), area):
            route = np.concatenate([route, following[None]])
    return fitted(route, budget, None, None)


def myopic_route(
    area: Area, errors: PointErrors, budget: float, start: np.ndarray, spacing: float
) -> np.ndarray:
    """Steps of equal length, each in the direction after which the model expects the least error."""
    angles = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    steps = STEP * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    number, route = round(budget / spacing), start[None]
    for _ in range(round(budget / STEP)):
        # A step that no direction allows is shortened.
        for share in (1.0, 0.5, 0.25):
            ends = route[-1] + share * steps
            ends = ends[[stays_inside(np.stack([route[-1], end]), area) for end in ends]]
            if len(ends):
                break
        else:
            break
        ways = [np.concatenate([route, end[None]]) for end in ends]
        distances = spacing * np.arange(1, number + 1)
        samples = np.stack([points_along(way, distances) for way in ways])
        taken = np.stack([distances <= length_of(way) + 1e-9 for way in ways])
        padding = [(0, HEADINGS - len(ends)), (0, 0)]  # one compiled program
        samples, taken = np.pad(samples, [*padding, (0, 0)]), np.pad(taken, padding)
        scores = np.asarray(_after(errors, jnp.asarray(samples), jnp.asarray(taken)))[: len(ends)]
        route = ways[int(np.argmin(scores))]
    return route


def corner_route(
    side: float, errors: PointErrors, budget: float, start: np.ndarray, spacing: float
) -> np.ndarray:
    """Straight to the nearest corner of the square `[0, side]^2`, and from there back and forth in lines.

    The lines are evenly spaced, and stop as far from the border as the budget requires. Of all numbers of
    lines along either side, the one is chosen after which the model expects the least error.
    """
    distances = spacing * np.arange(1, round(budget / spacing) + 1)
    routes = []
    for number, is_along_x in itertools.product(LINES, (False, True)):

        def excess(inset: float, number: int = number, is_along_x: bool = is_along_x) -> float:
            return length_of(_lines(side, start, number, is_along_x, inset)) - budget

        if excess(0.0) > 0.0 > excess(0.49 * side):
            inset = root_scalar(excess, bracket=(0.0, 0.49 * side)).root
            routes.append(_lines(side, start, number, is_along_x, inset))
    samples = jnp.asarray(np.stack([points_along(route, distances) for route in routes]))
    scores = _after(errors, samples, jnp.ones(samples.shape[:2], bool))
    return routes[int(np.argmin(scores))]


def _lines(side: float, start: np.ndarray, number: int, is_along_x: bool, inset: float) -> np.ndarray:
    """A route from `start` along lines that end `inset` before the border."""
    low, high = inset, side - inset
    across = np.repeat(np.linspace(low, high, number), 2)
    along = np.resize([low, high, high, low], 2 * number)
    corners = np.stack([along, across] if is_along_x else [across, along], axis=1)
    return np.concatenate([start[None], np.where(start > 0.5 * side, side - corners, corners)])


@eqx.filter_jit
def _after(errors: PointErrors, samples: jax.Array, taken: jax.Array) -> jax.Array:
    return jax.vmap(errors.after)(samples, taken)
