"""The searches of bench_tune.py, run in a process with its own cores."""

import contextlib
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from bench_tune import parse
from peers import installed
from rich.console import Console
from rich.table import Table

from bojax.config.sweep import load_config
from bojax.engine.program_cache import held
from bojax.engine.run import run_sweeps
from bojax.engine.targets import Request
from bojax.optimisation.search import Search, Values
from bojax.optimisation.space import Range
from bojax.report.ranking import Measure
from bojax.report.source import load
from bojax.tuning.ranges import described
from bojax.tuning.task import Task

PEAK = (0.03, 2.0, 0.4)
SPACE = (
    Range("rate", 1e-4, 1.0, is_log=True, is_integer=False),
    Range("scale", 1e-1, 1e3, is_log=True, is_integer=False),
    Range("weight", 0.0, 1.0, is_log=False, is_integer=False),
)
KCBTS = (
    Range("planner.exploration", 1.0, 1000.0, is_log=True, is_integer=False),
    Range("planner.noise_variance", 1e-4, 1.0, is_log=True, is_integer=False),
    Range("planner.discount", 0.5, 1.0, is_log=False, is_integer=False),
)
EMU_Q = (
    Range("learner.features.state_lengthscale", 0.03, 3.0, is_log=True, is_integer=False),
    Range("learner.prior_precision", 1e-3, 10.0, is_log=True, is_integer=False),
    Range("learner.discount", 0.8, 0.999, is_log=False, is_integer=False),
)
RUNS, FRESH = 8, 200
"""Runs of a point of an experiment, and of a chosen point with another seed."""


class Method(Protocol):
    """A search over settings; higher scores are better."""

    def propose(self, number: int) -> list[Values]:
        """The points of a batch."""
        ...

    def tell(self, points: Sequence[Values], scores: Sequence[float]) -> None:
        """Learn the scores of the last batch."""
        ...


class Random:
    """Uniform points, by the logarithm where the range is."""

    def __init__(self, ranges: Sequence[Range], seed: int):
        self._ranges, self._random = ranges, np.random.default_rng(seed)

    def propose(self, number: int) -> list[Values]:
        """The points of a batch."""
        return [
            tuple(each.value([self._random.uniform(*each.box)]) for each in self._ranges)
            for _ in range(number)
        ]

    def tell(self, points: Sequence[Values], scores: Sequence[float]) -> None:
        """Learn nothing."""


def load_optuna() -> Callable[[Sequence[Range], int], Method]:
    """Optuna's TPE, which treats the points of a batch that have no score yet as bad."""
    import optuna  # pyright: ignore[reportMissingImports]

    optuna.logging.set_verbosity(optuna.logging.ERROR)

    class TPE:
        def __init__(self, ranges: Sequence[Range], seed: int):
            sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
            self._study = optuna.create_study(direction="maximize", sampler=sampler)
            self._ranges, self._trials = ranges, []

        def propose(self, number: int) -> list[Values]:
            self._trials = [self._study.ask() for _ in range(number)]
            return [
                tuple(
                    trial.suggest_float(each.key, each.low, each.high, log=each.is_log)
                    for each in self._ranges
                )
                for trial in self._trials
            ]

        def tell(self, points: Sequence[Values], scores: Sequence[float]) -> None:
            del points
            for trial, score in zip(self._trials, scores, strict=True):
                self._study.tell(trial, score)

    return TPE


def synthetic(values: Values) -> float:
    """A peak of height 1, of which two settings depend on each other; it is narrow in the first."""
    rate, scale, weight = values
    a, b, c = math.log10(rate / PEAK[0]), math.log10(scale / PEAK[1]), 4.0 * (weight - PEAK[2])
    return math.exp(-1.5 * a**2 - 0.5 * (b - 0.5 * a) ** 2 - 0.5 * c**2)


@dataclass(frozen=True)
class Problem:
    """A problem of the benchmark.

    Attributes:
        name: Its name.
        ranges: The tuned settings.
        scores: Makes, from a seed, a function that gives the scores of a batch of points.
        true: The value of a chosen point, or its mean score in fresh runs; more is better.
        cost: Seconds that a batch counts beside the processor time it takes.
    """

    name: str
    ranges: tuple[Range, ...]
    scores: Callable[[int], Callable[[list[Values]], list[float]]]
    true: Callable[[Values], float]
    cost: float = 0.0


class Found(NamedTuple):
    """The point that a search chose, the number of its batches, and its seconds."""

    point: Values
    batches: int
    seconds: float


def search(
    method: Method,
    problem: Problem,
    seed: int,
    batch: int,
    rounds: int,
    seconds: float,
) -> Found:
    """A search, which ends after some batches or seconds."""
    evaluate = problem.scores(seed)
    points, scores, used, batches = [], [], 0.0, 0
    begin = time.process_time()
    while batches < rounds and used < seconds:
        proposed = method.propose(batch)
        observed = evaluate(proposed)
        method.tell(proposed, observed)
        points, scores, batches = points + proposed, scores + observed, batches + 1
        used = time.process_time() - begin + batches * problem.cost
    expected = method.predict(points)[0] if isinstance(method, Search) else scores
    return Found(points[int(np.argmax(expected))], batches, used)


def synthetic_scores(noise: float) -> Callable[[int], Callable[[list[Values]], list[float]]]:
    """Scores of the synthetic function."""

    def of_seed(seed: int) -> Callable[[list[Values]], list[float]]:
        random = np.random.default_rng([seed, 1])
        return lambda points: [synthetic(point) + noise * random.standard_normal() for point in points]

    return of_seed


def experiment(
    name: str, config: str, overrides: list[str], ranges: tuple[Range, ...], measure: Measure
) -> Problem:
    """An experiment of bojax, scored by the mean of a column; all points of a search have the same runs."""

    def scores(seed: int, runs: int = RUNS) -> Callable[[list[Values]], list[float]]:
        content = load_config(config, ["engine.segment_seconds=60", *overrides], runs, seed)
        task = Task(content, ranges, measure.column, measure.is_least, 1, 1, 0, ())

        def evaluate(points: list[Values]) -> list[float]:
            with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere:
                out = Path(folder) / "round"
                with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
                    code = run_sweeps([Request(task.sweep(points, "round"), out)], False, ["bojax", "bench"])
                if code:
                    raise RuntimeError(f"the runs ended with exit code {code}")
                results = load(out)
                means = [measure.values(results, point).mean() for point in results.points]
                return [measure.sign * float(mean) for mean in means]

        return evaluate

    return Problem(name, ranges, scores, lambda point: scores(10_000, FRESH)([point])[0])


def main(argv: list[str]) -> int:
    """Run all searches, and print the true value, or the score on fresh runs, of what each method chooses."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    methods: dict[str, Any] = {
        "bojax": lambda ranges, seed: Search(ranges, seed, args.batch, args.rounds * args.batch),
        **installed({"Optuna, TPE": ("optuna", load_optuna)}),
        "random": Random,
    }
    problems = (
        (Problem("synthetic", SPACE, synthetic_scores(args.noise), synthetic, args.cost), args.searches),
        (experiment("parking", "parking", [], KCBTS, Measure("return", False)), args.parking),
        (
            experiment(
                "mountain car", "mountain-car", ["episodes=20"], EMU_Q, Measure("steps_to_goal", True)
            ),
            args.learning,
        ),
    )
    bound = f" or {args.seconds:g} s" if math.isfinite(args.seconds) else ""
    table = Table(title=f"At most {args.rounds} batches of {args.batch} points{bound}")
    for heading in ("problem", "method", "searches", "chosen: mean", "least", "batches", "s a search"):
        table.add_column(heading, justify="left" if heading in ("problem", "method") else "right")
    record = []
    with held():
        for problem, count in problems:
            for name, method in methods.items() if count else ():
                search(method(problem.ranges, 0), problem, 0, args.batch, 2, math.inf)  # compiles
                found, chosen = [], []
                for seed in range(args.seed, args.seed + count):
                    each = method(problem.ranges, seed)
                    found.append(search(each, problem, seed, args.batch, args.rounds, args.seconds))
                    chosen.append(problem.true(found[-1].point))
                    words = described(problem.ranges, found[-1].point)
                    print(f"{problem.name}, {name}, seed {seed}: {chosen[-1]:.3f} at {words}", flush=True)
                batches, seconds = ([getattr(each, key) for each in found] for key in ("batches", "seconds"))
                cells = (f"{np.mean(chosen):.3f}", f"{min(chosen):.3f}", f"{np.mean(batches):.1f}")
                table.add_row(problem.name, name, str(count), *cells, f"{np.mean(seconds):.1f}")
                record.append(
                    {
                        "problem": problem.name,
                        "method": name,
                        "chosen": chosen,
                        "batches": batches,
                        "seconds": seconds,
                    }
                )
    Console().print(table)
    if args.json:
        names = ("rounds", "batch", "noise", "seed", "cost")
        settings = {name: getattr(args, name) for name in names}
        settings["seconds"] = args.seconds if math.isfinite(args.seconds) else None
        args.json.write_text(json.dumps({"settings": settings, "results": record}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
