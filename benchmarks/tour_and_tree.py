"""What a tree search over the next step adds to the tour of a mission for hot spots or a threshold.

    python benchmarks/tour_and_tree.py hotspots --starts 6 --json hotspots.json

Fields, starts and scores are those of the league. Three missions of one length are compared: the league's,
whose tour is searched for anew after every 5 units; the same after every unit; and the latter with a tree
over the next unit. The tree has an action node for the first unit of the tour and for one in each of 8
directions, and below it a belief node for each of 16 imagined sets of its measurements, drawn from the
belief. The value of such a node is the least loss of 12 tours that go on from there: unlike the tour alone,
the tree knows that the rest is chosen after the measurements. The unit with the least mean is driven. A ratio
is that of the sums over the fields, with its 95% interval over the starts.
"""

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import numpy as np

from bojax.areas.shapes import to_area
from bojax.report.statistics import ratio_interval
from bojax.surveys.lawnmower import Ground
from bojax.surveys.league.fields import Field, league
from bojax.surveys.league.routes import LEG, SPACING, adaptive_route
from bojax.surveys.league.scores import scores_of, threshold_of
from bojax.surveys.mission import Mission
from bojax.surveys.polylines import Waypoints, length_of, points_along
from bojax.surveys.route import fitted
from bojax.surveys.search import THINNING, Search

UNIT = 1.0
DIRECTIONS, DRAWS, LEAVES, TOURS = 8, 16, 12, 40
"""Directions of the next unit, imagined sets of measurements, tours below each, and tours drawn for these."""

MEASURES = {"hotspots": "regret", "threshold": "missed"}
METHODS = ("every 5 units", "every unit", "every unit, with a tree")


class Tree(Search):
    """A tree over the next unit, whose leaves are tours."""

    def next_route(self, planned: Waypoints) -> Waypoints:
        """The route whose first unit has the least mean loss after the choice of the rest."""
        first = fitted(planned, UNIT, None, None)
        actions = [first, *self._straight()]
        rests = [planned[1:] if length_of(planned) <= UNIT else _behind(planned, UNIT)[1:]]
        tours = [route for _ in range(TOURS) if (route := self._within(self._tour())) is not None]
        best = np.argsort(self._errors_after(tours))[: LEAVES - 1] if tours else []
        rests += [tours[index][1:] for index in best]
        noise = np.random.default_rng(0).standard_normal((DRAWS, len(self._points)))
        values, routes = [], []
        for action in actions:
            together = [
                route for rest in rests if (route := self._within(np.concatenate([action, rest]))) is not None
            ]
            if together:
                losses = self._losses(together, length_of(action), noise)  # [draws, routes]
                values.append(losses.min(axis=1).mean())
                routes.append(together[int(losses.mean(axis=0).argmin())])
        return routes[int(np.argmin(values))] if routes else planned

    def _straight(self) -> list[Waypoints]:
        """Straight units in all directions that stay in the area."""
        angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        ends = self._start + UNIT * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        is_clear = self._area.contains(ends)
        is_clear[is_clear] = self._ways.are_clear(
            np.broadcast_to(self._start, (is_clear.sum(), 2)), ends[is_clear]
        )
        return [np.stack([self._start, end]) for end in ends[is_clear]]

    def _losses(self, routes: Sequence[Waypoints], driven: float, noise: np.ndarray) -> np.ndarray:
        """The loss after each route, for each draw of the measurements of its first part: `[D, R]`."""
        explained = np.stack([self._explained(route) for route in routes])
        first = self._explained(fitted(routes[0], driven, None, None))
        at = self._samples(fitted(routes[0], driven, None, None))
        joint = self._covariance[np.ix_(at, at)] + self._noise * np.eye(len(at))
        # What the mean will be after the measurements, less what it is.
        moves = np.linalg.solve(np.linalg.cholesky(joint), self._covariance[at][:, ::THINNING])
        means = self._mean[::THINNING] + noise[:, : len(at)] @ moves
        variance = self._covariance.diagonal()[::THINNING]
        left = np.maximum(variance - first, 1e-9 * variance)
        more = np.maximum(explained - first, 0.0)
        with np.errstate(over="ignore"):  # in exponentials of places that nothing is learned of
            # What the first part gains counts as well: the highest mean is that before it.
            highest = self._mean[::THINNING].max()
            return np.stack([self._goal.loss(mean, left, more, highest) for mean in means])

    def _samples(self, route: Waypoints) -> np.ndarray:
        """Indices of the points nearest to the samples of a route."""
        distances = self._step * np.arange(1, int(length_of(route) / self._step * (1.0 + 1e-9)) + 1)
        return np.asarray(self._tree.query(points_along(route, distances))[1])

    def _explained(self, route: Waypoints) -> np.ndarray:
        """Reduction of the variances by the samples of a route."""
        at = self._samples(route)
        across = self._covariance[at][:, ::THINNING]
        joint = self._covariance[np.ix_(at, at)] + self._noise * np.eye(len(at))
        return np.sum(across * np.linalg.solve(joint, across), axis=0)


def _behind(route: Waypoints, distance: float) -> Waypoints:
    """The part of a route behind a distance from its start."""
    driven = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1)))
    return np.concatenate([points_along(route, np.array([distance])), route[driven > distance]])


def with_tree(mission: Mission, planned: Waypoints, seed: int) -> Waypoints:
    """A plan whose first unit is chosen by a tree; without measurements, the plan itself."""
    if not mission.num_measurements:
        return planned
    ground = Ground.of(mission.area, mission.position)
    random = np.random.default_rng([seed, mission.num_measurements])
    with jax.enable_x64(True):
        tree = Tree(
            mission.posterior(), to_area(ground.shape), mission.remaining, mission.position, None,
            mission.goal, spacing=SPACING, ways=ground.transfers, random=random,
        )  # fmt: skip
    return tree.next_route(planned)


def main(argv: Sequence[str]) -> int:
    """Drive and score all missions, and print the ratios after each start."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("goal", choices=MEASURES)
    parser.add_argument("--starts", type=int, default=6, choices=range(1, 21), help="number of starts (6)")
    parser.add_argument("--length", type=float, default=20.0, help="length of the missions (20)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the errors to a file")
    args = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    errors: dict[str, list[list[float]]] = defaultdict(list)  # [starts][fields] of each method
    fields = league()
    for index in range(args.starts):
        seconds = dict.fromkeys(METHODS, 0.0)
        for method in METHODS:
            begin = time.process_time()
            errors[method].append([_error(field, args.length, index, args.goal, method) for field in fields])
            seconds[method] = time.process_time() - begin
        print(
            f"start {index}: CPU seconds", {name: round(value) for name, value in seconds.items()}, flush=True
        )
        if args.json:
            content = {"fields": [field.name for field in fields], "length": args.length, "errors": errors}
            args.json.write_text(json.dumps(content, indent=1))
        if index:
            print(_ratios(errors), flush=True)
    return 0


def _error(field: Field, length: float, index: int, goal: str, method: str) -> float:
    name = f"threshold={threshold_of(field)}" if goal == "threshold" else goal
    leg = LEG if method == METHODS[0] else UNIT
    changed = {"changed": partial(with_tree, seed=index)} if method == METHODS[2] else {}
    route = adaptive_route(field, length, index, name, leg, **changed)
    return scores_of(field, route, length, index)[MEASURES[goal]]


def _ratios(errors: dict[str, list[list[float]]]) -> str:
    lines = []
    for own, other in ((METHODS[1], METHODS[0]), (METHODS[2], METHODS[1]), (METHODS[2], METHODS[0])):
        sums = [np.sum(errors[name], axis=1) for name in (own, other)]
        ratio = ratio_interval(*sums)
        low, estimate, high = (100.0 * (each - 1.0) for each in (ratio.low, ratio.estimate, ratio.high))
        lines.append(f"{own} over {other}: {estimate:+.1f}% [{low:.1f}, {high:.1f}], {len(sums[0])} starts")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
