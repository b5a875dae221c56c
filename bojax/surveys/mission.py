"""A survey that goes on: plan the rest, drive a part of it, tell what was measured, plan again."""

import dataclasses
import json
import warnings
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bojax.areas.area import Area
from bojax.config.extras import MissingExtra
from bojax.fields.raster import LARGEST
from bojax.fields.scale import unit_doubt
from bojax.models.evidence import LogPrior, log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.results.store import write_arrays
from bojax.surveys.beliefs import belief_from, model_of
from bojax.surveys.goals import Goal, goal_of
from bojax.surveys.planning import Demand, lawnmower_guesses
from bojax.surveys.polylines import Waypoints, length_of, rest_of
from bojax.surveys.route import ROUNDING, Route, RouteOptions, plan_route, spread_points, stays_inside
from bojax.surveys.search import Search, part_around

OPTIONS = RouteOptions(restarts=4, steps=120, models=4)  # the earlier plan is a good first guess

FAR = 1.0  # sizes of the area beyond its bounds at which a position is taken for an error
LEAST_DATA = 10  # measurements before hyper-parameters are learned
SPREAD = 1.0  # of the log-normal prior of the hyper-parameters
MOST_EXACT = 256
"""Measurements up to which the belief is exact in a plan; of more, it is summarised at as many points.

Hyper-parameters are learned from as many of them at most."""

MOST_MAPPED = 1024  # the same in a prediction

RELEARNING = 2**31  # first of the numbers that are folded into the keys of relearning; plans have small ones
NOTHING: Waypoints = np.zeros((0, 2))


class Mission:
    """A survey of an area with a budget of distance, for a robot or for a person who drives.

    The belief is a Gaussian process of the standardised values with a Matern 5/2 kernel. Numbers are in
    float64, whatever the settings of JAX. Once its programs are compiled, a plan compiles nothing until the
    measurements outgrow the capacity, which doubles then.

    Attributes:
        area: Area to survey.
        position: Where the robot is, m.
        remaining: Distance left, m.
        counts: How often input was left out, by reason: `not_finite`, `too_large` (a value that
            files have for missing data, beyond 1e30 in magnitude), `far_off` (a position), `duplicate`,
            `bad_pose`; and `time_backwards`, for measurements that are kept.
        hyperparameters: Lengthscale (m), variance and noise variance, both of standardised values.
        route: The last plan.
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
    ):
        """Prepare a mission.

        Args:
            area: Area to survey, m.
            budget: Distance that may be driven, m.
            start: First position, m.
            end: Last position, m; anywhere by default.
            spacing: Distance between two measurements, m.
            lengthscale: Lengthscale of the field before it is learned, m; a sixth of the area by default.
            noise_variance: Variance of the noise before it is learned, as a share of the values' variance.
            relearn_every: Number of measurements after which the hyper-parameters are learned anew; None for
                on request only.
            options: Options of the optimiser of routes; by default `OPTIONS`, with less work than those of a
                single plan. Goals that depend on values have none: their routes are searched for.
            seed: Seed of the tours and of the search for hyper-parameters.
            goal: `"map"`, `"hotspots"` for the highest place, `"threshold=V"` for the places above a value,
                or the part of the area that counts in a map. Without a measurement, the first plan is for a
                map.

        Raises:
            ValueError: A number is not positive, the start is not a position, or the goal is not known.
        """
        x_min, y_min, x_max, y_max = area.bounds
        self._size = max(x_max - x_min, y_max - y_min)
        lengthscale = self._size / 6.0 if lengthscale is None else lengthscale
        numbers = {
            "budget": budget,
            "spacing": spacing,
            "lengthscale": lengthscale,
            "noise_variance": noise_variance,
            "relearn_every": 1 if relearn_every is None else relearn_every,
        }
        for name, value in numbers.items():
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: got {value}; allowed: > 0")
        self.area, self.remaining, self.position = area, float(budget), _position("start", start)
        self.end = None if end is None else _position("end", end)
        self.spacing, self.relearn_every, self.seed = float(spacing), relearn_every, seed
        self.options = OPTIONS if options is None else options
        self.goal = goal_of(goal)
        self.hyperparameters = (float(lengthscale), 1.0, float(noise_variance))
        self._medians = self.hyperparameters
        self.counts: Counter[str] = Counter()
        self.route: Route | None = None
        self._x, self._y, self._time = NOTHING, np.zeros(0), -np.inf
        self._held: set[tuple[float, ...]] = set()  # rows of both, by which duplicates are found
        self._shift, self._scale = 0.0, 1.0
        self._learned_at, self._plans = 0, 0
        self._is_doubted = False  # the unit of the values, by a warning

    @property
    def num_measurements(self) -> int:
        """Measurements in the belief."""
        return len(self._y)

    def plan(self) -> Waypoints:
        """The next waypoints `[W, 2]`, m, to the end of the budget; none if the budget is used.

        If the budget does not allow more than the way to the fixed end, this is the plan. From a position
        outside the area, the route leads to the nearest point inside first.
        """
        entry = self._entry()
        to_entry = float(np.linalg.norm(entry - self.position))
        left = self.remaining - to_entry
        to_end = self._way_to_end(entry)
        if left <= max(self.spacing, length_of(to_end) * (1.0 + ROUNDING)):
            return NOTHING if self.end is None else to_end if to_entry > 0.0 else to_end[1:]
        self._plans += 1
        with jax.enable_x64(True):
            self.route = (
                self._searched(entry, left) if self.goal.needs_values else self._descended(entry, left)
            )
        route = self.route.waypoints
        return route if to_entry > 0.0 else route[1:]

    def _way_to_end(self, entry: Waypoints) -> Waypoints:
        """The shortest way in the area to the end; a straight one if there is none, or no end."""
        straight = np.stack([entry, entry if self.end is None else self.end])
        if stays_inside(straight, self.area):
            return straight
        try:
            return part_around(self.area, entry)[1].path(*straight)
        except ValueError:
            return straight

    def _descended(self, entry: Waypoints, left: float) -> Route:
        """A route of least expected error at the places that count."""
        key = jax.random.fold_in(jax.random.key(self.seed), self._plans)
        return plan_route(
            self.posterior(), self.area, left, entry, self.end, self._guesses(entry, left), key,
            spacing=self.spacing, target=self.goal.region, options=self._options,
        )  # fmt: skip

    def _searched(self, entry: Waypoints, left: float) -> Route:
        """A route of least loss of a goal that depends on values; of a map without any."""
        goal = Goal()
        if self.num_measurements:
            goal = dataclasses.replace(self.goal, threshold=(self.goal.threshold - self._shift) / self._scale)
        area, ways = part_around(self.area, entry)
        random = np.random.default_rng([self.seed, self._plans])
        search = Search(
            self.posterior(),
            area,
            left,
            entry,
            self.end,
            goal,
            spacing=self.spacing,
            ways=ways,
            random=random,
        )
        return search.route(self._earlier(entry))

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

    def observe(self, points: Any, values: Any, pose: Any = None, times: Any = None) -> int:
        """Take measurements into the belief, and move the robot.

        The distance driven, along the measured points to the pose, is taken from the budget. What cannot be
        used is left out and counted in `counts`. Values in an unlikely unit are kept, with one warning in a
        mission (see `bojax.fields.scale`).

        Args:
            points: Positions of any number of measurements, in the order of driving, `[S, 2]`, m.
            values: Measured values `[S]`; NaN for no data.
            pose: Position of the robot (further numbers, as a heading, are ignored); by default, the last
                measurement.
            times: Times of the measurements, only to count those that run backwards.

        Returns:
            Number of measurements taken.

        Raises:
            ValueError: There are not as many values, or times, as points.
        """
        points = np.asarray(points, float).reshape(-1, 2)
        values = np.asarray(values, float).reshape(-1)
        if len(points) != len(values):
            raise ValueError(f"values: got {len(values)}; allowed: {len(points)}, one for each point")
        if times is not None:
            times = np.asarray(times, float).reshape(-1)
            if len(times) != len(points):
                raise ValueError(f"times: got {len(times)}; allowed: {len(points)}, one for each point")
            self.counts["time_backwards"] += int(np.sum(np.diff(np.append(self._time, times)) < 0.0))
            self._time = max(self._time, *times.tolist()) if len(times) else self._time
        is_far = ~self._is_near(points)
        is_finite = np.isfinite(values) & np.isfinite(points).all(axis=1)
        self._move(points[~is_far], pose)
        rows = np.column_stack([points, values])
        is_taken = np.zeros(len(rows), bool)
        for index, row in enumerate(map(tuple, rows.tolist())):
            reason = (
                "not_finite" if not is_finite[index]
                else "too_large" if abs(values[index]) > LARGEST
                else "far_off" if is_far[index]
                else "duplicate" if row in self._held
                else ""
            )  # fmt: skip
            if reason:
                self.counts[reason] += 1
                continue
            self._held.add(row)
            is_taken[index] = True
        self._x = np.concatenate([self._x, points[is_taken]])
        self._y = np.concatenate([self._y, values[is_taken]])
        if not self._is_doubted and (doubt := unit_doubt(self._y)):
            self._is_doubted = True
            warnings.warn(f"values: {doubt}", stacklevel=2)
        every = self.relearn_every
        if every is not None and self.num_measurements - self._learned_at >= max(every, LEAST_DATA):
            self.relearn()
        return int(np.sum(is_taken))

    def relearn(self) -> None:
        """Standardise the values, and learn the hyper-parameters from them by their evidence.

        Each has a log-normal prior about its first value, and the lengthscale stays between the spacing and
        twice the size of the area. With fewer than `LEAST_DATA` measurements, nothing changes.
        """
        if self.num_measurements < LEAST_DATA:
            return
        self._learned_at = self.num_measurements
        self._shift, scale = float(np.mean(self._y)), float(np.std(self._y))
        self._scale = scale if scale > 0.0 else 1.0
        with jax.enable_x64(True):
            key = jax.random.fold_in(jax.random.key(self.seed), RELEARNING + self.num_measurements)
            prior = _prior_about(self._medians)
            gp, _ = relearn(self._learned_from(), key, log_prior=prior, num_starts=2)
            kernel: Any = gp.kernel
            found = kernel.kernel.lengthscale, kernel.variance, gp.noise_variance
        lengthscale, variance, noise = map(float, found)
        lengthscale = float(np.clip(lengthscale, self.spacing, 2.0 * self._size))
        self.hyperparameters = (lengthscale, variance, noise)

    def posterior(self) -> GaussianProcess:
        """The belief about the standardised values that a plan is made from.

        It has room for a power of two of them or, beyond `MOST_EXACT`, is a `sparse_posterior`.
        """
        return self._belief(MOST_EXACT)

    def _belief(self, most: int) -> GaussianProcess:
        """The belief, exact up to a number of measurements."""
        return belief_from(self.hyperparameters, self._x, (self._y - self._shift) / self._scale, most)

    def _learned_from(self) -> GaussianProcess:
        """The exact belief from a random part of the measurements, if there are many."""
        chosen = np.arange(self.num_measurements)
        if self.num_measurements > MOST_EXACT:
            random = np.random.default_rng([self.seed, self.num_measurements])
            chosen = np.sort(random.choice(chosen, MOST_EXACT, replace=False))
        values = (self._y[chosen] - self._shift) / self._scale
        return belief_from(self.hyperparameters, self._x[chosen], values, MOST_EXACT)

    def predict(self, points: Any, most: int = MOST_MAPPED) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the field at points `[M, 2]`, in the units of the values.

        Up to `most` measurements they are exact; of more, the belief is summarised at as many points.
        """
        with jax.enable_x64(True):
            mean, variance = self._belief(most).predict(np.asarray(points, float))
            deviation = np.sqrt(np.asarray(variance))
        return self._shift + self._scale * np.asarray(mean), self._scale * deviation

    def save(self, path: str | Path) -> None:
        """Write the mission to a file, which is replaced at once or not at all."""
        plain = {name: getattr(self, name) for name in _PLAIN}
        plain["counts"], plain["options"] = dict(self.counts), dataclasses.asdict(self.options)
        region = () if self.goal.region is None else self.goal.region.outline
        plain["goal"] = self.goal.kind, self.goal.threshold, len(region)
        plain["rings"] = [len(zone) for zone in (self.area.outline, *self.area.avoid)]
        rings = [ring for zone in (self.area.outline, *self.area.avoid) for ring in zone] + list(region)
        arrays: dict[str, Any] = {f"ring_{index}": ring for index, ring in enumerate(rings)}
        arrays |= {"x": self._x, "y": self._y, "position": self.position}
        arrays |= {"end": NOTHING if self.end is None else self.end}
        arrays |= {"route": NOTHING if self.route is None else self.route.waypoints}
        write_arrays(Path(path), {"plain": np.asarray(json.dumps(plain)), **arrays})

    @classmethod
    def load(cls, path: str | Path) -> "Mission":
        """The mission in a file that `save` wrote.

        Raises:
            ValueError: The file is not one.
            FileNotFoundError: There is no such file.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                data = {name: file[name] for name in file.files}
            plain = json.loads(str(data["plain"]))
            options = plain.pop("options")
            options["stretch"] = tuple(options["stretch"])
            kind, threshold, of_region = plain.pop("goal", ("map", np.nan, 0))
            number = sum(plain["rings"]) + of_region
            rings = iter([data[f"ring_{index}"] for index in range(number)])
            zones = [tuple(next(rings) for _ in range(number)) for number in plain.pop("rings")]
            end = data["end"] if data["end"].size else None
            area = Area(zones[0], tuple(zones[1:]))
            region = Area(tuple(rings)) if of_region else None
            mission = cls(area, 1.0, data["position"], end, spacing=1.0, options=RouteOptions(**options))
            mission.goal = Goal(kind, threshold, region)
            mission.counts = Counter(plain.pop("counts"))
            mission._x, mission._y = data["x"], data["y"]
            mission._held = set(map(tuple, np.column_stack([data["x"], data["y"]]).tolist()))
            for name in _PLAIN:
                setattr(mission, name, plain[name])
            mission.hyperparameters = tuple(plain["hyperparameters"])
            mission._medians = tuple(plain["_medians"])
            if len(data["route"]):
                mission.route = Route(data["route"], length_of(data["route"]), np.nan, "earlier plan", {})
        except FileNotFoundError:
            raise
        except Exception as error:
            raise ValueError(f"{path}: not a saved mission, or damaged") from error
        return mission

    def _is_near(self, points: Waypoints) -> np.ndarray:
        """Whether points are finite and within `FAR` sizes of the bounds."""
        x_min, y_min, x_max, y_max = self.area.bounds
        low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
        beyond = np.maximum(low - points, points - high)
        return np.all(beyond <= FAR * self._size, axis=-1)  # False for NaN

    def _move(self, points: Waypoints, pose: Any) -> None:
        """Go along the points to the pose, and take the length from the budget."""
        way = [self.position, *points]
        if pose is not None:
            pose = np.asarray(pose, float).reshape(-1)[:2]
            if len(pose) == 2 and self._is_near(pose[None])[0]:
                way.append(pose)
            else:
                self.counts["bad_pose"] += 1
        self.remaining = max(self.remaining - length_of(np.array(way)), 0.0)
        self.position = np.array(way[-1])

    def _entry(self) -> Waypoints:
        """The position, or the nearest of the grid's points if it lies outside the area."""
        if self.area.distances(self.position[None])[0] >= 0.0:
            return self.position
        points = spread_points(self.area, 1200)
        return points[np.argmin(np.linalg.norm(points - self.position, axis=1))]

    def _earlier(self, entry: Waypoints) -> Waypoints | None:
        """The rest of the earlier plan, if it stays in the area."""
        rest = None if self.route is None else rest_of(self.route.waypoints, entry)
        return rest if rest is not None and stays_inside(rest, self.area) else None

    def _guesses(self, entry: Waypoints, left: float) -> dict[str, Waypoints]:
        """The rest of the earlier plan or, if there is none that stays in the area, the best lawnmowers."""
        if (rest := self._earlier(entry)) is not None:
            return {"earlier plan": rest}
        try:
            return lawnmower_guesses(
                self.posterior(), self.area, self.goal.region, Demand(left, entry, self.end), self.spacing,
                self.options.restarts,
            )  # fmt: skip
        except (MissingExtra, ValueError):  # without shapely, or a budget for them
            return {}


_PLAIN = (
    "remaining", "spacing", "relearn_every", "seed", "hyperparameters", "_medians", "_time", "_shift",
    "_scale", "_learned_at", "_plans",
)  # fmt: skip
"""Attributes of a mission that are saved as JSON."""


@lru_cache(maxsize=8)
def _prior_about(medians: tuple[float, float, float]) -> LogPrior:
    """The prior of all missions with these medians: each function compiles `relearn` anew."""
    return log_normal_prior(*model_of(medians), SPREAD)


def _position(name: str, at: Any) -> Waypoints:
    point = np.asarray(at, float).reshape(-1)[:2]
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"{name}: got {at}; allowed: x and y in metres")
    return point
