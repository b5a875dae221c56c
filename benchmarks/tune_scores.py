"""The searches of bench_tune.py, run in a process with its own cores."""

import contextlib
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np
from bench_tune import parse
from peers import installed
from rich.console import Console
from rich.table import Table

from bojax.cli.tuning import Task
from bojax.config.sweep import load_config
from bojax.config.tuning import Range, described
from bojax.engine.requests import Request
from bojax.engine.run import run_sweeps
from bojax.engine.tuning import Search, Values
from bojax.report.source import load

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
RUNS, FRESH = 8, 200
"""Runs of a point of parking, and of a chosen point with another seed."""


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
            tuple(each.value(self._random.uniform(*each.box)) for each in self._ranges) for _ in range(number)
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


def search(
    method: Method, rounds: int, batch: int, evaluate: Callable[[list[Values]], list[float]]
) -> Values:
    """The point that a method chooses after some batches."""
    points, scores = [], []
    for _ in range(rounds):
        proposed = method.propose(batch)
        observed = evaluate(proposed)
        method.tell(proposed, observed)
        points, scores = points + proposed, scores + observed
    expected = method.predict(points)[0] if isinstance(method, Search) else scores
    return points[int(np.argmax(expected))]


def noisy(seed: int, noise: float) -> Callable[[list[Values]], list[float]]:
    """Scores of the synthetic function."""
    random = np.random.default_rng([seed, 1])
    return lambda points: [synthetic(point) + noise * random.standard_normal() for point in points]


def parking(ranges: tuple[Range, ...], runs: int, seed: int) -> Callable[[list[Values]], list[float]]:
    """Mean returns of kCBTS on parking; all points have the same runs."""
    config = load_config("parking", ["engine.segment_seconds=60"], runs, seed)
    task = Task(config, ranges, "return", False, 1, 1, 0, ())

    def evaluate(points: list[Values]) -> list[float]:
        with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere:
            out = Path(folder) / "round"
            with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
                code = run_sweeps([Request(task.sweep(points, "round"), out)], False, ["bojax", "bench"])
            if code:
                raise RuntimeError(f"the runs ended with exit code {code}")
            results = load(out)
            return [float(results.runs_of(point)["return"].mean()) for point in results.points]

    return evaluate


def main(argv: list[str]) -> int:
    """Run all searches, and print the true value, or the score on fresh runs, of what each method chooses."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    methods: dict[str, Any] = {
        "bojax": lambda ranges, seed: Search(ranges, seed, args.batch, args.rounds * args.batch),
        **installed({"Optuna, TPE": ("optuna", load_optuna)}),
        "random": Random,
    }
    table = Table(title=f"{args.rounds} batches of {args.batch} points")
    for heading in ("problem", "method", "searches", "chosen: mean", "least", "s a search"):
        table.add_column(heading, justify="left" if heading in ("problem", "method") else "right")
    record = []
    for problem, ranges, count in (("synthetic", SPACE, args.searches), ("parking", KCBTS, args.parking)):
        for name, method in methods.items():
            found, begin = [], time.perf_counter()
            for seed in range(args.seed, args.seed + count):
                is_parking = problem == "parking"
                evaluate = parking(ranges, RUNS, seed) if is_parking else noisy(seed, args.noise)
                chosen = search(method(ranges, seed), args.rounds, args.batch, evaluate)
                value = parking(ranges, FRESH, 10_000)([chosen])[0] if is_parking else synthetic(chosen)
                print(
                    f"{problem}, {name}, seed {seed}: {value:.3f} at {described(ranges, chosen)}", flush=True
                )
                found.append(value)
            if found:
                seconds = (time.perf_counter() - begin) / count
                cells = (f"{np.mean(found):.3f}", f"{min(found):.3f}", f"{seconds:.1f}")
                table.add_row(problem, name, str(count), *cells)
                record.append({"problem": problem, "method": name, "chosen": found, "seconds": seconds})
    Console().print(table)
    if args.json:
        names = ("rounds", "batch", "noise", "seed")
        content = {"settings": {name: getattr(args, name) for name in names}, "results": record}
        args.json.write_text(json.dumps(content, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
