"""The timings of bench_bo.py, run in a process with its own cores."""

import itertools
import statistics
import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from bench_bo import parse
from peers import installed, print_ratios
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.functions import LogExpectedImprovement
from bojax.models.kernels import Matern52

LOW, HIGH = (-5.0, 0.0), (10.0, 15.0)
MINIMUM = 0.39788735772973816
LENGTHSCALE = 0.5  # in the box [-1, 1]^2
NOISE_VARIANCE = 1e-4  # relative to standardised values
CPU_LANES = 8

Run = Callable[[int, int, int], float]
"""Takes a seed, the number of evaluations and the number of random ones; returns the least value found."""


def branin(x, cos=np.cos):
    """Branin's function, which has three minima of 0.397887 in [-5, 10] x [0, 15]."""
    a = x[1] - 5.1 / (4.0 * np.pi**2) * x[0] ** 2 + 5.0 / np.pi * x[0] - 6.0
    return a**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * cos(x[0]) + 10.0


def load_bayes_opt() -> Run:
    """A run of bayes_opt, which maximises."""
    from bayes_opt import BayesianOptimization  # pyright: ignore[reportMissingImports]

    def run(seed: int, evaluations: int, initial: int) -> float:
        bounds = {"a": (LOW[0], HIGH[0]), "b": (LOW[1], HIGH[1])}
        optimizer = BayesianOptimization(
            lambda a, b: -branin((a, b)), bounds, random_state=seed, verbose=0, allow_duplicate_points=True
        )
        optimizer.maximize(init_points=initial, n_iter=evaluations - initial)
        return -optimizer.max["target"]

    return run


def load_scikit_optimize() -> Run:
    """A run of scikit-optimize."""
    from skopt import gp_minimize  # pyright: ignore[reportMissingImports]

    def run(seed: int, evaluations: int, initial: int) -> float:
        bounds = list(zip(LOW, HIGH, strict=True))
        found = gp_minimize(branin, bounds, n_calls=evaluations, n_initial_points=initial, random_state=seed)
        return float(found.fun)

    return run


def load_botorch() -> Run:
    """A run of BoTorch, which maximises, with given hyper-parameters and log expected improvement."""
    import gpytorch  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]
    from botorch.acquisition import LogExpectedImprovement  # pyright: ignore[reportMissingImports]
    from botorch.models import SingleTaskGP  # pyright: ignore[reportMissingImports]
    from botorch.optim import optimize_acqf  # pyright: ignore[reportMissingImports]

    torch.set_num_threads(1)
    low, high = torch.tensor(LOW, dtype=torch.float64), torch.tensor(HIGH, dtype=torch.float64)
    bounds = torch.tensor([[-1.0, -1.0], [1.0, 1.0]], dtype=torch.float64)

    def observe(points: Any) -> Any:
        return torch.stack([-branin(low + (high - low) * (point + 1.0) / 2.0, torch.cos) for point in points])

    def run(seed: int, evaluations: int, initial: int) -> float:
        torch.manual_seed(seed)
        x = 2.0 * torch.rand(initial, 2, dtype=torch.float64) - 1.0
        y = observe(x)
        for _ in range(evaluations - initial):
            values = ((y - y.mean()) / y.std(correction=0))[:, None]
            kernel = gpytorch.kernels.MaternKernel(nu=2.5)
            noise = torch.full_like(values, NOISE_VARIANCE)
            model = SingleTaskGP(x, values, noise, covar_module=kernel, outcome_transform=None)
            kernel.lengthscale = LENGTHSCALE
            acquisition = LogExpectedImprovement(model, best_f=values.max())
            point, _ = optimize_acqf(acquisition, bounds, q=1, num_restarts=5, raw_samples=128)
            x, y = torch.cat([x, point]), torch.cat([y, observe(point)])
        return -float(y.max())

    return run


def bojax_run(
    run: jax.Array, seed: jax.Array, evaluations: int, initial: int, relearn_every: int = 0
) -> tuple[jax.Array, jax.Array]:
    """The points and the least value found by a run of bojax, which maximises."""
    optimisation = BayesianOptimisation(
        kernel=Matern52(jnp.asarray(LENGTHSCALE)),
        acquisition=LogExpectedImprovement(jnp.asarray(0.0)),
        noise_variance=jnp.asarray(NOISE_VARIANCE),
        low=jnp.asarray(LOW),
        high=jnp.asarray(HIGH),
        capacity=evaluations,
        num_initial=initial,
        relearn_every=relearn_every,
    )
    key = jax.random.fold_in(jax.random.key(seed), run)
    _, xs, ys = optimisation.maximise(key, lambda key, x: -branin(x, jnp.cos), evaluations)
    return xs, -jnp.max(ys)


def main(argv: list[str]) -> int:
    """Time all libraries, and print how close they come to the minimum."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    # Peers warn about hyper-parameters at their bounds and about duplicate points.
    warnings.filterwarnings("ignore")
    sizes = (args.evaluations, args.initial)
    peers: dict[str, Run] = installed(
        {
            "bayes_opt": ("bayes_opt", load_bayes_opt),
            "scikit-optimize": ("skopt", load_scikit_optimize),
            "BoTorch": ("botorch", load_botorch),
        }
    )
    rows, least = [], {}
    for name, run in peers.items():
        run(args.seed, args.initial + 1, args.initial)  # the first iteration loads and caches modules
        seeds, found = itertools.count(args.seed), []

        def timed(run=run, seeds=seeds, found=found):
            found.append(run(next(seeds), *sizes))

        rows.append(Row(name, 1, median_seconds(timed, args.repeats), args.evaluations))
        least[name] = found

    batched = partial(bojax_run, evaluations=args.evaluations, initial=args.initial)
    learning = partial(batched, relearn_every=1)
    cases = [("one run", batched, 1), ("one run that relearns", learning, 1)]
    for how, function, runs in cases + [("runs", batched, runs) for runs in args.runs]:
        lanes = runs if on_gpu() else min(runs, CPU_LANES)
        what, seed = f"bojax, {how}", jnp.asarray(args.seed)
        rows.append(
            time_runs(
                what,
                function,
                runs,
                lanes,
                args.evaluations,
                args.repeats,
                prepare=lambda run, seed=seed: seed,
            )
        )
    seed = jnp.asarray(args.seed)
    _, values = jax.jit(jax.vmap(batched, in_axes=(0, None)))(jnp.arange(max(args.runs)), seed)
    least["bojax"] = np.asarray(values).tolist()
    learn = jax.jit(learning)
    least["bojax that relearns"] = [float(learn(jnp.asarray(run), seed)[1]) for run in range(20)]

    print_rows(
        f"Bayesian optimisation of Branin's function, {args.evaluations} evaluations",
        "iterations",
        rows,
        rows[0].what,
    )
    print_ratios(rows, {})
    for name, found in least.items():
        regret = statistics.median(found) - MINIMUM
        print(f"{name}: {regret:.4f} above the minimum in the median of {len(found)} runs")
    if args.json:
        names = ("evaluations", "initial", "seed", "repeats")
        write_record(args.json, "bo", "iterations", rows, {name: getattr(args, name) for name in names})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
