"""Bayesian optimisation of a function of the user's: `minimise`, `maximise`, and step by step."""

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Console

from bojax.api.errors import BojaxError
from bojax.api.optimisation import Evaluation, OptimisationResult
from bojax.config.errors import shown
from bojax.engine.bar import Bar
from bojax.models.checks import check_count, check_flag
from bojax.optimisation.search import Search, Values
from bojax.optimisation.space import checked_point, read_space
from bojax.text import error_line

LEAST_CAPACITY = 32
"""Capacity of the first model; each further one, which is compiled anew, has twice as many observations."""

MOST_EVALUATIONS = 10_000
"""Largest expected number of evaluations: the memory of the model grows with its square."""

Workers = Callable[[Callable[[Mapping[str, Any]], float], Sequence[Mapping[str, Any]]], Iterable[float]]
"""`map`, or a function that evaluates in parallel, such as the `map` of an executor."""


class ObjectiveError(BojaxError):
    """The function that is optimised raised an error, the cause of this one, or returned no number.

    Attributes:
        result: What was found before.
    """

    def __init__(self, message: str, result: OptimisationResult):
        super().__init__(message)
        self.result = result


class Optimiser:
    """Proposes points of a space and learns from their values, for loops of one's own.

    Values are modelled by a Gaussian process in float64 whose hyper-parameters are relearned after every
    `tell`; the next point maximises the logarithm of the expected improvement, or, with noise, a confidence
    bound (see `Search`). A value of NaN or infinity is a failure: the point is not proposed again, and does
    not enter the model.
    """

    def __init__(
        self,
        space: Mapping[str, Any],
        *,
        maximise: bool = False,
        noisy: bool = False,
        initial: int | None = None,
        batch: int = 1,
        capacity: int = LEAST_CAPACITY,
        seed: int = 0,
    ):
        """Start an optimisation.

        Args:
            space: For each name a tuple `(low, high)`, of integers if both bounds are, a tuple `(low, high,
                "log")` for a range that spans decades, or a list of choices.
            maximise: Whether higher values are better.
            noisy: Whether evaluations of one point differ from time to time.
            initial: Number of quasi-random points in the beginning; by default 2 for each axis and 2 more, at
                most 16.
            batch: Largest number of points that are proposed together.
            capacity: Expected number of evaluations. For more of them, a larger program is compiled.
            seed: Seed of the proposals.

        Raises:
            SpaceError: The space is wrong; a `ValueError`.
            ValueError: Another argument is wrong.
        """
        self._axes = read_space(space)
        self._sign = 1.0 if check_flag("maximise", maximise) else -1.0
        self._is_noisy = check_flag("noisy", noisy)
        self._seed = check_count("seed", seed, 0)
        if self._seed >= 2**63:
            raise ValueError(f"seed: got {shown(seed)}; allowed: below 2^63")
        self._batch = check_count("batch", batch, 1)
        self._initial = (
            min(16, 2 + 2 * len(self._axes)) if initial is None else check_count("initial", initial, 1)
        )
        self._evaluations: list[Evaluation] = []
        if check_count("capacity", capacity, 1) > MOST_EVALUATIONS:
            raise ValueError(
                f"evaluations: got {capacity}; allowed: <= {MOST_EVALUATIONS}, for the model's memory"
            )
        self._search = self._new(max(LEAST_CAPACITY, capacity))

    @property
    def batch(self) -> int:
        """Largest number of points that are proposed together."""
        return self._batch

    def ask(self) -> dict[str, Any]:
        """The next point to evaluate; it stays the same until `tell` is called.

        Raises:
            ValueError: All points of the space have been tried.
        """
        points = self.ask_batch(1)
        if not points:
            raise ValueError("all points of the space have been tried")
        return points[0]

    def ask_batch(self, number: int) -> list[dict[str, Any]]:
        """Points to evaluate together; fewer if no others are left.

        Raises:
            ValueError: `number` is above `batch`.
        """
        if check_count("number", number, 1) > self._batch:
            raise ValueError(f"number: got {number}; allowed: from 1 to {self._batch}, the batch")
        names = [axis.key for axis in self._axes]
        return [dict(zip(names, values, strict=True)) for values in self._search.propose(number)]

    def tell(self, point: Mapping[str, Any], value: float) -> None:
        """Learn the value of a point, which need not have been proposed.

        Raises:
            ValueError: The point is not in the space, or the value is not a number.
        """
        self.tell_batch([point], [value])

    def tell_batch(self, points: Sequence[Mapping[str, Any]], values: Sequence[float]) -> None:
        """Learn the values of points.

        Raises:
            ValueError: A point is not in the space, a value is not a number, or there are more of one.
        """
        if len(points) != len(values):
            raise ValueError(f"values: got {len(values)}; allowed: {len(points)}, one for each point")
        told = [
            Evaluation(checked_point(self._axes, point), _number(value))
            for point, value in zip(points, values, strict=True)
        ]
        self._evaluations += told
        if len(self._evaluations) > self._capacity:
            self._search = self._new(2 ** math.ceil(math.log2(len(self._evaluations))))
            told = self._evaluations
        if told:
            self._search.tell([self._values(each) for each in told], [self._score(each) for each in told])

    def result(self) -> OptimisationResult:
        """What was found so far."""
        is_known = any(map(Evaluation.is_finite, self._evaluations))
        search = copy.copy(self._search) if is_known else None  # later values change the search itself
        return OptimisationResult(
            tuple(self._evaluations), self._axes, self._sign > 0.0, self._is_noisy, search
        )

    def _new(self, capacity: int) -> Search:
        self._capacity = capacity
        return Search(
            self._axes, self._seed, self._batch, capacity, is_noisy=self._is_noisy, initial=self._initial
        )

    def _values(self, evaluation: Evaluation) -> Values:
        return tuple(evaluation.point[axis.key] for axis in self._axes)

    def _score(self, evaluation: Evaluation) -> float:
        return self._sign * evaluation.value if evaluation.is_finite() else math.nan


def minimise(
    function: Callable[..., float],
    space: Mapping[str, Any],
    /,
    budget: int = 50,
    *,
    batch: int = 1,
    known: Iterable[tuple[Mapping[str, Any], float]] = (),
    noisy: bool = False,
    initial: int | None = None,
    workers: Workers = map,
    seed: int = 0,
    progress: bool = True,
) -> OptimisationResult:
    """Find the least value of a function that is expensive to evaluate, by Bayesian optimisation.

    `bojax.minimise(lambda x, y: (x - 1) ** 2 + y, {"x": (-5.0, 5.0), "y": (0, 10)}, budget=30)` has the best
    point in `.best` and its value in `.value`.

    Args:
        function: Takes a value for each name of the space as keyword arguments, and returns a number. NaN and
            infinity mean that the evaluation failed.
        space: For each name a tuple `(low, high)`, of integers if both bounds are, a tuple `(low, high,
            "log")` for a range that spans decades, or a list of choices.
        budget: Number of evaluations, without the known ones.
        batch: Number of points that are proposed together.
        known: Evaluations that have already been made: pairs of a point and its value.
        noisy: Whether evaluations of one point differ from time to time. The best point is then the one with
            the best mean under the model, and not the one with the luckiest value.
        initial: Number of quasi-random points at the beginning, including known ones; by default 2 for
            each axis and 2 more, at most 16.
        workers: Evaluates the points of a batch: `map`, or `map` of an executor, which does so in parallel.
        seed: Seed of the proposals.
        progress: Whether to show the number of evaluations and the best value.

    Returns:
        The best point, its value, and all evaluations. Ctrl-C ends the optimisation early.

    Raises:
        ValueError: An argument is wrong.
        ObjectiveError: The function raised an error or returned no number; the `result` of this error has
            what was found before.
    """
    settings = {"maximise": False, "noisy": noisy, "initial": initial, "seed": seed}
    return _optimised(function, space, budget, batch, known, workers, progress, settings)


def maximise(
    function: Callable[..., float],
    space: Mapping[str, Any],
    /,
    budget: int = 50,
    *,
    batch: int = 1,
    known: Iterable[tuple[Mapping[str, Any], float]] = (),
    noisy: bool = False,
    initial: int | None = None,
    workers: Workers = map,
    seed: int = 0,
    progress: bool = True,
) -> OptimisationResult:
    """Find the greatest value of a function; everything else is as in `bojax.minimise`."""
    settings = {"maximise": True, "noisy": noisy, "initial": initial, "seed": seed}
    return _optimised(function, space, budget, batch, known, workers, progress, settings)


def _optimised(
    function: Callable[..., float],
    space: Mapping[str, Any],
    budget: int,
    batch: int,
    known: Iterable[tuple[Mapping[str, Any], float]],
    workers: Workers,
    progress: bool,
    settings: Mapping[str, Any],
) -> OptimisationResult:
    """Optimise with an `Optimiser` that has room for all evaluations, and the known ones."""
    if not callable(function):
        raise ValueError(f"function: got {shown(function)}; allowed: a function")
    if not callable(workers):
        raise ValueError(f"workers: got {shown(workers)}; allowed: a function such as pool.map")
    try:
        pairs = [(point, value) for point, value in known]
    except (TypeError, ValueError):
        allowed = "pairs of a point and its value, such as [({'x': 0.5}, 1.2)]"
        raise ValueError(f"known: got {shown(known)}; allowed: {allowed}") from None
    budget, is_quiet = check_count("budget", budget, 1), not check_flag("progress", progress)
    batch = min(check_count("batch", batch, 1), budget)
    optimiser = Optimiser(space, batch=batch, capacity=budget + len(pairs), **settings)
    optimiser.tell_batch([point for point, _ in pairs], [value for _, value in pairs])
    done = 0
    with Bar("optimising", budget, Console(stderr=True, quiet=is_quiet)) as bar:
        try:
            while done < budget and (points := optimiser.ask_batch(min(optimiser.batch, budget - done))):
                _evaluate(optimiser, function, points, workers)
                done += len(points)
                value = optimiser.result().value
                bar.show(done, "no value yet" if value is None else f"best {value:.6g}")
        except KeyboardInterrupt:
            number = len(optimiser.result().evaluations) - len(pairs)
            bar.say(f"stopped after {number} evaluations")
    return optimiser.result()


def _evaluate(
    optimiser: Optimiser,
    function: Callable[..., float],
    points: Sequence[Mapping[str, Any]],
    workers: Workers,
) -> None:
    """Evaluate points and tell their values; also those that are known when it fails or is interrupted.

    Raises:
        ObjectiveError: The function raised an error, or returned no number.
    """
    values: list[float] = []
    try:
        for value in workers(partial(_call, function), points):
            values.append(_number(value))
        if len(values) != len(points):
            raise ValueError(f"workers: got {len(values)} values; allowed: {len(points)}, one for each point")
    except (Exception, KeyboardInterrupt) as error:
        optimiser.tell_batch(points[: len(values)], values[: len(points)])
        if isinstance(error, KeyboardInterrupt):
            raise
        failed = points[min(len(values), len(points) - 1)]
        at = ", ".join(f"{name}={shown(value)}" for name, value in failed.items())
        raise ObjectiveError(
            f"the evaluation at {at} failed: {error_line(error)}", optimiser.result()
        ) from error
    optimiser.tell_batch(points, values)


def _call(function: Callable[..., float], point: Mapping[str, Any]) -> float:
    return function(**point)  # a function of the module, which processes can be sent


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"value: got {shown(value)}; allowed: a number") from None
