"""Routes of least loss by random search: tours through likely places, and changes of the best of them.

A goal that depends on values has many local optima, one for each order of the places that are worth a visit:
the search compares whole tours, which a descent from evenly spread lines would not reach.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from bojax.areas.area import Area, longer_side
from bojax.areas.transfers import Transfers
from bojax.models.gaussian_process import GaussianProcess
from bojax.surveys.goals import Goal
from bojax.surveys.guesses import tour
from bojax.surveys.lawnmower import cut, joined
from bojax.surveys.polylines import Waypoints, distance_to, length_of, points_along
from bojax.surveys.route import NUM_SCORED, Route, spread_points
from bojax.surveys.team import FAN, keep_separation

NUM_SAMPLES = 40
"""Samples of a route while it is compared; each stands for several measurements, or for a part of one."""

NUM_TOURS, NUM_KEPT = 48, 3
"""Tours that are drawn, and the number of the best routes that are changed."""

NUM_BATCHES = 4
"""Times that tours are drawn, if none before can be driven."""

NUM_ROUNDS, NUM_CHANGES = 13, 10
"""Rounds of changes, and changes of each route in a round."""

THINNING = 3
"""One of so many points counts in the loss: samples lie at the points, and need more of them."""

STOP_DISTANCE = 0.3
"""Budget for each stop of the tours with the most stops, as a share of the area's size."""

MOST_STOPS = 100
"""Stops that are added to a route at most, until its budget is used."""

UNTOLD = 1e6
"""Noise variance of a sample that is not taken, in variances of the field."""

REACH = 0.1
"""Standard deviation of the move of a stop in the first round, as a share of the area's size."""

_moments = eqx.filter_jit(GaussianProcess.predict_covariance)


class Search:
    """A search for the route of one robot.

    Tours through likely places are drawn, and the best are changed at random: a stop is moved, added or left
    out, and the change is kept if the loss falls.
    """

    def __init__(
        self,
        posterior: GaussianProcess,
        area: Area,
        budget: float,
        start: Waypoints,
        end: Waypoints | None,
        goal: Goal,
        *,
        spacing: float,
        ways: Transfers,
        random: np.random.Generator,
        others: Sequence[Waypoints] = (),
        separation: float = 0.0,
    ):
        """Prepare the search.

        Args:
            posterior: Belief about the field, of positions in metres.
            area: Area to survey, in one part.
            budget: Maximum length, m, with which the end can be reached.
            start: First point, m.
            end: Last point, m; free if None.
            goal: What the route is for, in the units of the belief.
            spacing: Distance between two measurements, m.
            ways: Shortest paths in the area.
            random: Generator of tours and changes.
            others: Routes of other robots, whose samples count as taken.
            separation: Least distance from them, m, as of `least_distance`.
        """
        self._size = longer_side(area.bounds)
        self._area, self._budget, self._start, self._end = area, budget, start, end
        self._ways, self._random = ways, random
        self._points, self._goal = spread_points(area, NUM_SCORED), goal
        self._tree = KDTree(self._points)
        self._mean, self._covariance = map(np.asarray, _moments(posterior, jnp.asarray(self._points)))
        self._step = budget / NUM_SAMPLES
        self._noise = float(posterior.noise_variance) * spacing / self._step
        self._others, self._separation = others, separation
        for other in others:
            self._covariance = self._after(other)
        weights = goal.weights(self._mean, np.sqrt(np.maximum(self._covariance.diagonal(), 0.0)))
        # Some stops are drawn evenly: a single likely place would leave no way to use the budget.
        self._shares = 0.9 * weights / weights.sum() + 0.1 / len(weights)

    def _after(self, other: Waypoints) -> np.ndarray:
        """The covariance after the samples of another robot, moved to the nearest points; means stay."""
        distances = self._step * np.arange(1, int(length_of(other) / self._step) + 1)
        gaps, at = self._tree.query(points_along(other, distances).reshape(-1, 2))
        at = np.asarray(at)[gaps < self._size / 20.0]  # not in another part of the area
        across = self._covariance[at]
        joint = across[:, at] + self._noise * np.eye(len(at))
        return self._covariance - across.T @ np.linalg.solve(joint, across)

    def route(self, earlier: Waypoints | None = None) -> Route:
        """The best route that is found, from the rest of an earlier plan, if there is one, and from tours.

        Raises:
            ValueError: No tour stays in the area, or none keeps the separation.
        """
        drawn = [] if earlier is None else [("earlier plan", earlier)]
        for batch in range(NUM_BATCHES):
            first = 1 + NUM_TOURS * batch
            drawn += [(f"tour {number}", self._tour()) for number in range(first, first + NUM_TOURS)]
            found = [(name, route) for name, stops in drawn if (route := self._within(stops)) is not None]
            if found:
                break
            drawn = []
        else:
            raise ValueError(
                "route: no tour stays in the area; allowed: an area in one part"
                if self._separation == 0.0
                else f"separation: got {self._separation:g} m, which no tour keeps; allowed: a smaller one"
            )
        errors = self._errors_after([route for _, route in found])
        candidates = {name: float(error) for (name, _), error in zip(found, errors, strict=True)}
        best = np.argsort(errors, kind="stable")[:NUM_KEPT]
        kept = [found[index][1] for index in best]
        for number in range(NUM_ROUNDS):
            kept = self._improved(kept, REACH * self._size * 0.3 ** (number / NUM_ROUNDS))
        errors = self._errors_after(kept)
        names = [f"improved from {found[index][0]}" for index in best]
        candidates |= dict(zip(names, errors.tolist(), strict=True))
        first = int(np.argmin(errors))
        ordered = dict(sorted(candidates.items(), key=lambda each: each[1]))
        return Route(kept[first], length_of(kept[first]), float(errors[first]), names[first], ordered)

    def _improved(self, kept: list[Waypoints], reach: float) -> list[Waypoints]:
        """The best of each route and of its changes: different tours do not compete yet."""
        changed = [
            (route, self._within(self._changed(route, reach))) for route in kept for _ in range(NUM_CHANGES)
        ]
        routes = [before if after is None else after for before, after in changed]
        errors = self._errors_after([*kept, *routes])
        errors, after = errors[: len(kept)], errors[len(kept) :].reshape(len(kept), NUM_CHANGES)
        best = after.argmin(axis=1)
        return [
            routes[index * NUM_CHANGES + best[index]] if after[index, best[index]] < errors[index] else route
            for index, route in enumerate(kept)
        ]

    def _tour(self) -> Waypoints:
        """A short tour through likely stops, of a random number."""
        most = 2 + int(self._budget / (STOP_DISTANCE * self._size))
        stops = np.unique(self._stops(int(self._random.integers(1, most + 1))), axis=0)
        route = tour(stops, len(stops), self._start, None, self._random)
        together = [other for other in self._others if distance_to(self._start, other[:1]) < self._separation]
        if not together:
            return route
        # From a common start, robots leave in directions of their own.
        angle = 2.0 * np.pi * self._random.random()
        aside = self._start + FAN * self._separation * np.array([np.cos(angle), np.sin(angle)])
        return np.insert(route, 1, aside, axis=0)

    def _changed(self, route: Waypoints, reach: float) -> Waypoints:
        """The route with a stop less, more or moved; the start stays."""
        index, kind = self._random.integers(1, len(route)), self._random.random()
        if kind < 0.15 and len(route) > 2:
            return np.delete(route, index, axis=0)
        if kind < 0.3:
            between = (route[index - 1] + route[index]) / 2.0 + reach * self._random.standard_normal(2)
            return np.insert(route, index, between, axis=0)
        moved = route.copy()
        moved[index] += reach * self._random.standard_normal(2)
        return moved

    def _within(self, stops: Waypoints) -> Waypoints | None:
        """The route through stops, and more of them until the budget is used.

        It is None if it leaves the area, or comes too close to another robot.
        """
        if not self._area.contains(stops[1:]).all():
            return None
        try:
            route = joined([stops], self._ways)
            for _ in range(MOST_STOPS):
                if length_of(route) >= self._budget:
                    break
                route = np.concatenate([route, joined([route[-1:], self._stops(1)], self._ways)[1:]])
            route = cut(route, self._budget, self._end, self._ways)
        except ValueError:  # no way joins two stops
            return None
        return route if keep_separation([route], self._separation, self._others) else None

    def _stops(self, number: int) -> Waypoints:
        return self._points[self._random.choice(len(self._points), number, p=self._shares)]

    def _errors_after(self, routes: list[Waypoints]) -> np.ndarray:
        """The loss after each route `[R]`, with its samples moved to the nearest points."""
        distances = self._step * np.arange(1, NUM_SAMPLES + 1)
        samples = np.stack([points_along(route, distances) for route in routes])
        at = np.asarray(self._tree.query(samples)[1])  # [R, S]
        # A sample beyond the end of a shorter route tells nothing.
        lengths = np.array([length_of(route) for route in routes])
        is_taken = distances <= lengths[:, None] * (1.0 + 1e-9)
        noise = np.where(is_taken, self._noise, UNTOLD * self._covariance.diagonal().max())
        joint = self._covariance[at[:, :, None], at[:, None, :]]
        joint += noise[:, :, None] * np.eye(NUM_SAMPLES)
        across = self._covariance[:, ::THINNING][at]  # [R, S, M]
        explained = np.sum(across * np.linalg.solve(joint, across), axis=1)
        variance = self._covariance.diagonal()[::THINNING]
        return self._goal.loss(self._mean[::THINNING], variance, explained)
