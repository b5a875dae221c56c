"""The searches of bench_minimise.py, run in a process with its own cores."""

import argparse
import json
import math
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench_minimise import parse
from peers import installed
from rich.console import Console
from rich.table import Table

import bojax

Space = dict[str, Any]
Method = Callable[[Callable[..., float], Space, int, int], None]
"""Evaluates a function of keyword arguments over a space as often as it is told, with a seed."""


@dataclass(frozen=True)
class Problem:
    """A function, its space and its minimum."""

    function: Callable[..., float]
    space: Space
    minimum: float


def branin(x: float, y: float) -> float:
    """Branin's function, with three minima."""
    bowl = y - 5.1 / (4.0 * np.pi**2) * x**2 + 5.0 / np.pi * x - 6.0
    return bowl**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * math.cos(x) + 10.0


def camel(x: float, y: float) -> float:
    """The six-hump camel function."""
    return (4.0 - 2.1 * x**2 + x**4 / 3.0) * x**2 + x * y + (4.0 * y**2 - 4.0) * y**2


def ackley(*xs: float) -> float:
    """Ackley's function, with many local minima."""
    x = np.asarray(xs)
    ripple = math.exp(np.cos(2.0 * np.pi * x).mean())
    return float(20.0 + math.e - 20.0 * math.exp(-0.2 * math.sqrt((x**2).mean())) - ripple)


def rosenbrock(*xs: float) -> float:
    """Rosenbrock's function, with a curved valley."""
    x = np.asarray(xs)
    return float(np.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2))


def levy(*xs: float) -> float:
    """Levy's function."""
    w = 1.0 + (np.asarray(xs) - 1.0) / 4.0
    inner = (w[:-1] - 1.0) ** 2 * (1.0 + 10.0 * np.sin(np.pi * w[:-1] + 1.0) ** 2)
    last = (w[-1] - 1.0) ** 2 * (1.0 + np.sin(2.0 * np.pi * w[-1]) ** 2)
    return float(np.sin(np.pi * w[0]) ** 2 + inner.sum() + last)


def _hartmann(weights: Any, centres: Any) -> Callable[..., float]:
    heights, widths, at = np.asarray([1.0, 1.2, 3.0, 3.2]), np.asarray(weights), 1e-4 * np.asarray(centres)

    def hartmann(*xs: float) -> float:
        return -float(heights @ np.exp(-np.sum(widths * (np.asarray(xs) - at) ** 2, axis=1)))

    return hartmann


hartmann3 = _hartmann(
    [[3, 10, 30], [0.1, 10, 35], [3, 10, 30], [0.1, 10, 35]],
    [[3689, 1170, 2673], [4699, 4387, 7470], [1091, 8732, 5547], [381, 5743, 8828]],
)
hartmann6 = _hartmann(
    [
        [10, 3, 17, 3.5, 1.7, 8],
        [0.05, 10, 17, 0.1, 8, 14],
        [3, 3.5, 1.7, 10, 17, 8],
        [17, 8, 0.05, 10, 0.1, 14],
    ],
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ],
)


def mixed_ackley(a: str, n: int, x: float, y: float) -> float:
    """Ackley's function of a choice, an integer and two numbers."""
    return ackley({"left": -1.0, "middle": 0.0, "right": 1.0, "far": 2.0}[a], float(n - 3), x, y)


def mixed_training(model: str, layers: int, rate: float, decay: float) -> float:
    """Stands for the training of a model: an optimal rate that depends on the model and its layers."""
    offset, best = {"conv": (0.0, -2.5), "dense": (0.3, -3.0), "recurrent": (0.5, -2.0)}[model]
    error = (math.log10(rate) - best + 0.1 * layers) ** 2 + 0.3 * (math.log10(decay) + 4.0) ** 2
    return offset + 0.05 * (layers - 4) ** 2 + 1.0 - math.exp(-error)


def _box(low: float, high: float, dimensions: int) -> Space:
    return {f"x{index}": (low, high) for index in range(dimensions)}


def _of_box(function: Callable[..., float]) -> Callable[..., float]:
    return lambda **point: function(*point.values())


PROBLEMS = {
    "branin": Problem(branin, {"x": (-5.0, 10.0), "y": (0.0, 15.0)}, 0.39788735772973816),
    "camel": Problem(camel, {"x": (-3.0, 3.0), "y": (-2.0, 2.0)}, -1.0316284534898774),
    "hartmann-3": Problem(_of_box(hartmann3), _box(0.0, 1.0, 3), -3.8627797869493365),
    "hartmann-6": Problem(_of_box(hartmann6), _box(0.0, 1.0, 6), -3.322368011415515),
    "ackley-2": Problem(_of_box(ackley), _box(-30.0, 20.0, 2), 0.0),
    "ackley-5": Problem(_of_box(ackley), _box(-30.0, 20.0, 5), 0.0),
    "rosenbrock-4": Problem(_of_box(rosenbrock), _box(-2.0, 2.0, 4), 0.0),
    "levy-4": Problem(_of_box(levy), _box(-10.0, 10.0, 4), 0.0),
    "mixed-ackley": Problem(
        mixed_ackley,
        {"a": ["left", "middle", "right", "far"], "n": (0, 10), "x": (-5.0, 4.0), "y": (-5.0, 4.0)},
        0.0,
    ),
    "mixed-training": Problem(
        mixed_training,
        {
            "model": ["dense", "conv", "recurrent"],
            "layers": (1, 12),
            "rate": (1e-6, 1.0, "log"),
            "decay": (1e-8, 1e-1, "log"),
        },
        0.0,
    ),
}


NUMBERS_ALONE = ("bayes_opt",)
"""Methods without choices."""


def initial_points(space: Space) -> int:
    """Number of initial points of all methods that have some."""
    return min(16, 2 + 2 * len(space))


def ours(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
    """Bojax with its defaults."""
    bojax.minimise(function, space, evaluations, seed=seed, progress=False)


def random_search(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
    """Uniform points, by the logarithm where the range is."""
    random = np.random.default_rng(seed)

    def draw(axis: Any) -> Any:
        if isinstance(axis, list):
            return axis[random.integers(len(axis))]
        low, high = axis[:2]
        if isinstance(low, int) and isinstance(high, int):
            return int(random.integers(low, high + 1))
        return (
            10.0 ** random.uniform(math.log10(low), math.log10(high))
            if axis[2:]
            else random.uniform(low, high)
        )

    for _ in range(evaluations):
        function(**{name: draw(axis) for name, axis in space.items()})


def load_optuna() -> Method:
    """Optuna's TPE with its defaults."""
    import optuna  # pyright: ignore[reportMissingImports]

    optuna.logging.set_verbosity(optuna.logging.ERROR)

    def search(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
        def objective(trial: Any) -> float:
            point = {}
            for name, axis in space.items():
                if isinstance(axis, list):
                    point[name] = trial.suggest_categorical(name, axis)
                elif isinstance(axis[0], int):
                    point[name] = trial.suggest_int(name, *axis[:2], log=len(axis) > 2)
                else:
                    point[name] = trial.suggest_float(name, *axis[:2], log=len(axis) > 2)
            return function(**point)

        sampler = optuna.samplers.TPESampler(seed=seed)
        optuna.create_study(sampler=sampler).optimize(objective, n_trials=evaluations)

    return search


def load_scikit_optimize() -> Method:
    """scikit-optimize's Gaussian process with its defaults."""
    from skopt import gp_minimize  # pyright: ignore[reportMissingImports]
    from skopt.space import Categorical, Integer, Real  # pyright: ignore[reportMissingImports]

    def search(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
        def dimension(axis: Any) -> Any:
            if isinstance(axis, list):
                return Categorical(axis)
            kind = Integer if isinstance(axis[0], int) else Real
            return kind(*axis[:2], prior="log-uniform" if axis[2:] else "uniform")

        gp_minimize(
            lambda values: function(**dict(zip(space, values, strict=True))),
            [dimension(axis) for axis in space.values()],
            n_calls=evaluations,
            n_initial_points=initial_points(space),
            random_state=seed,
        )

    return search


def load_bayes_opt() -> Method:
    """bayes_opt with its defaults; of numbers alone."""
    from bayes_opt import BayesianOptimization  # pyright: ignore[reportMissingImports]

    def search(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
        optimizer = BayesianOptimization(
            lambda **point: -function(**point),
            space,
            random_state=seed,
            verbose=0,
            allow_duplicate_points=True,
        )
        initial = initial_points(space)
        optimizer.maximize(init_points=initial, n_iter=evaluations - initial)

    return search


def load_botorch() -> Method:
    """BoTorch's default process and qLogEI, over the unit cube with one-hot choices and rounded integers."""
    import torch  # pyright: ignore[reportMissingImports]
    from botorch.acquisition import qLogExpectedImprovement  # pyright: ignore[reportMissingImports]
    from botorch.fit import fit_gpytorch_mll  # pyright: ignore[reportMissingImports]
    from botorch.models import SingleTaskGP  # pyright: ignore[reportMissingImports]
    from botorch.models.transforms import Standardize  # pyright: ignore[reportMissingImports]
    from botorch.optim import optimize_acqf  # pyright: ignore[reportMissingImports]
    from gpytorch.mlls import ExactMarginalLogLikelihood  # pyright: ignore[reportMissingImports]

    from bojax.optimisation.space import read_space

    torch.set_num_threads(1)

    def search(function: Callable[..., float], space: Space, evaluations: int, seed: int) -> None:
        torch.manual_seed(seed)
        axes = read_space(space)
        low, high = np.asarray([axis.box for axis in axes for _ in range(axis.width)]).T

        def evaluate(unit: Any) -> tuple[Any, float]:
            position, first, point, snapped = low + unit.numpy() * (high - low), 0, {}, []
            for axis in axes:
                value = axis.value(position[first : first + axis.width].tolist())
                point[axis.key] = value
                snapped += axis.position(value)
                first += axis.width
            return torch.as_tensor((np.asarray(snapped) - low) / (high - low)), -function(**point)

        engine = torch.quasirandom.SobolEngine(len(low), scramble=True, seed=seed)
        units = list(engine.draw(initial_points(space)).double())
        told = [evaluate(unit) for unit in units]
        bounds = torch.stack([torch.zeros(len(low)), torch.ones(len(low))]).double()
        while len(told) < evaluations:
            x, y = torch.stack([each for each, _ in told]), torch.tensor([[v] for _, v in told]).double()
            model = SingleTaskGP(x, y, outcome_transform=Standardize(1))
            fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            acquisition = qLogExpectedImprovement(model, best_f=y.max())
            found, _ = optimize_acqf(acquisition, bounds, q=1, num_restarts=8, raw_samples=512)
            told.append(evaluate(found[0].detach()))

    return search


def regret(method: Method, problem: Problem, evaluations: int, seed: int) -> float:
    """The difference between the best value that a method finds and the minimum."""
    values: list[float] = []

    def function(**point: Any) -> float:
        if len(values) < evaluations:
            values.append(problem.function(**point))
        return values[-1]

    method(function, problem.space, evaluations, seed)
    return min(values) - problem.minimum


Key = tuple[str, str, int, int]
"""Function, method, seed and number of evaluations of a search."""


class Searches:
    """The regrets of searches; those that a file has are not run again.

    Args:
        path: A file with a line of JSON for each search, which may not exist yet; None keeps them in memory.
    """

    def __init__(self, path: Path | None):
        self._path = path
        lines = path.read_text().splitlines() if path and path.exists() else []
        self._found = {
            tuple(row["search"]): (row["regret"], row["seconds"]) for row in map(json.loads, lines)
        }

    def run(self, key: Key, method: Method, problem: Problem) -> tuple[float, float]:
        """The regret of a search, and its seconds."""
        if key not in self._found:
            _, _, seed, evaluations = key
            begin = time.perf_counter()
            found = regret(method, problem, evaluations, seed)
            self._found[key] = found, time.perf_counter() - begin
            if self._path:
                row = {"search": key, "regret": found, "seconds": self._found[key][1]}
                with self._path.open("a") as file:
                    file.write(json.dumps(row) + "\n")
        return self._found[key]


def load_methods(names: Sequence[str] | None) -> dict[str, Method]:
    """The installed methods, or those of them that are named."""
    methods: dict[str, Method] = {
        "bojax": ours,
        **installed(
            {
                "BoTorch": ("botorch", load_botorch),
                "Optuna": ("optuna", load_optuna),
                "bayes_opt": ("bayes_opt", load_bayes_opt),
                "scikit-optimize": ("skopt", load_scikit_optimize),
            }
        ),
        "random": random_search,
    }
    return {name: method for name, method in methods.items() if not names or name in names}


def takes(method: str, problem: Problem) -> bool:
    """Whether a method has what a space needs."""
    return method not in NUMBERS_ALONE or not any(isinstance(axis, list) for axis in problem.space.values())


def main(argv: list[str]) -> int:
    """Run all searches, seed by seed, and print the regrets."""
    args = parse(argv)
    warnings.simplefilter("ignore")
    methods = load_methods(args.methods)
    problems = {name: PROBLEMS[name] for name in args.functions or PROBLEMS}
    searches, found = Searches(args.searches), defaultdict[tuple[str, str], list[tuple[float, float]]](list)
    for seed in range(args.seed, args.seed + args.seeds):
        for title, problem in problems.items():
            for name, method in methods.items():
                if takes(name, problem):
                    key = (title, name, seed, args.evaluations)
                    found[title, name].append(searches.run(key, method, problem))
        print(f"seed {seed} is done", flush=True)
    report(found, args)
    return 0


def report(found: Mapping[tuple[str, str], list[tuple[float, float]]], args: argparse.Namespace) -> None:
    """Print the table of regrets and the number of functions where a method is among the first two."""
    table = Table(title=f"Simple regret after {args.evaluations} evaluations, {args.seeds} seeds")
    for heading in ("function", "method", "median regret", "95%", "seconds an evaluation"):
        table.add_column(heading, justify="left" if heading in ("function", "method") else "right")
    record, medians = [], defaultdict[str, dict[str, float]](dict)
    for (title, name), rows in found.items():
        regrets, seconds = np.asarray(rows).T
        each = float(np.median(seconds)) / args.evaluations
        draws = np.random.default_rng(0).choice(regrets, (2000, len(regrets)))
        low, high = np.quantile(np.median(draws, axis=1), (0.025, 0.975))
        medians[title][name] = float(np.median(regrets))
        shown = (f"{medians[title][name]:.2g}", f"{low:.2g} to {high:.2g}", f"{each:.3f}")
        table.add_row(title, name, *shown)
        record.append({"function": title, "method": name, "regrets": regrets.tolist(), "seconds": each})
    Console(width=100).print(table)
    for name in dict.fromkeys(name for _, name in found):
        ranks = [sorted(each, key=each.__getitem__).index(name) for each in medians.values() if name in each]
        best = sum(rank < 2 for rank in ranks)
        print(f"{name}: among the first two by median on {best} of {len(ranks)} functions")
    if args.json:
        args.json.write_text(json.dumps({"evaluations": args.evaluations, "rows": record}, indent=1))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
