"""The timings of bench_gp.py, run in a process with its own cores."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from bench_gp import parse
from peers import installed, print_ratios
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF

NOISE_VARIANCE = 0.01
CPU_LANES = 8  # the data of more processes do not fit into the cache
AIMS = {"tinygp": 1.5, "scikit-learn": 1.5, "BoTorch": 3.0}


@dataclass(frozen=True)
class Data:
    """Observations, queries and lengthscales of all processes, along the first axis."""

    x: np.ndarray
    y: np.ndarray
    queries: np.ndarray
    lengthscales: np.ndarray


def make_data(seed: int, processes: int, points: int, queries: int, dims: int) -> Data:
    """Sines of random frequencies in a unit box, with noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(size=(processes, points, dims))
    frequencies = rng.uniform(3.0, 9.0, size=(processes, 1, dims))
    noise = np.sqrt(NOISE_VARIANCE) * rng.normal(size=(processes, points))
    return Data(
        x=x,
        y=np.sin(frequencies * x).sum(axis=-1) + noise,
        queries=rng.uniform(size=(processes, queries, dims)),
        lengthscales=rng.uniform(0.2, 0.4, size=processes),
    )


def bojax_process(x, y, queries, lengthscale):
    """Mean and variance by bojax."""
    return GaussianProcess.fit(RBF(lengthscale), jnp.asarray(NOISE_VARIANCE), x, y).predict(queries)


def plain_jax_process(x, y, queries, lengthscale):
    """Mean and variance in plain JAX."""

    def gram(a, b):
        return jnp.exp(-0.5 * jnp.sum(((a[:, None, :] - b[None, :, :]) / lengthscale) ** 2, axis=-1))

    factor = jnp.linalg.cholesky(gram(x, x) + NOISE_VARIANCE * jnp.eye(len(x)))
    cross = gram(x, queries)
    whitened = jax.scipy.linalg.solve_triangular(factor, cross, lower=True)
    mean = cross.T @ jax.scipy.linalg.cho_solve((factor, True), y)
    return mean, 1.0 - jnp.sum(whitened**2, axis=0)


def load_tinygp() -> Callable:
    """Mean and variance by tinygp, of one process."""
    import tinygp  # pyright: ignore[reportMissingImports]

    def process(x, y, queries, lengthscale):
        kernel = tinygp.kernels.ExpSquared(lengthscale, distance=tinygp.kernels.distance.L2Distance())
        return tinygp.GaussianProcess(kernel, x, diag=NOISE_VARIANCE).predict(y, queries, return_var=True)

    return process


def load_gpjax() -> Callable:
    """Mean and variance by GPJax, of one process."""
    import gpjax  # pyright: ignore[reportMissingImports]

    def process(x, y, queries, lengthscale):
        kernel = gpjax.kernels.RBF(lengthscale=lengthscale)
        prior = gpjax.Prior(kernel, gpjax.mean_functions.Zero(), jitter=0.0)
        model = gpjax.ConjugateModel(prior, gpjax.likelihoods.Gaussian(np.sqrt(NOISE_VARIANCE)))
        predictive = model.condition(gpjax.Dataset(x, y[:, None]))(queries)
        return predictive.mean, predictive.variance

    return process


def load_scikit_learn() -> Callable:
    """Means and variances by scikit-learn, of all processes."""
    from sklearn.gaussian_process import GaussianProcessRegressor, kernels

    def processes(data: Data):
        results = []
        for x, y, queries, lengthscale in zip(data.x, data.y, data.queries, data.lengthscales, strict=True):
            settings: dict[str, Any] = {"alpha": NOISE_VARIANCE, "optimizer": None}
            model: Any = GaussianProcessRegressor(kernels.RBF(lengthscale), **settings)
            mean, std = model.fit(x, y).predict(queries, return_std=True)
            results.append((mean, std**2))
        return tuple(np.stack(part) for part in zip(*results, strict=True))

    return processes


def load_botorch() -> Callable:
    """Means and variances by BoTorch, of all processes in one batch."""
    import gpytorch  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]
    from botorch.models import SingleTaskGP  # pyright: ignore[reportMissingImports]

    torch.set_num_threads(1)

    def processes(data: Data):
        x, y, queries, lengthscales = map(torch.as_tensor, (data.x, data.y, data.queries, data.lengthscales))
        batch = torch.Size([len(x)])
        kernel = gpytorch.kernels.RBFKernel(batch_shape=batch)
        values = y[..., None]
        model = SingleTaskGP(
            x,
            values,
            train_Yvar=torch.full_like(values, NOISE_VARIANCE),
            covar_module=kernel,
            mean_module=gpytorch.means.ZeroMean(batch_shape=batch),
            outcome_transform=None,
        )
        kernel.lengthscale = lengthscales[:, None, None]
        with torch.no_grad():
            posterior = model.posterior(queries)
            return posterior.mean[..., 0].numpy(), posterior.variance[..., 0].numpy()

    return processes


def main(argv: list[str]) -> int:
    """Check that all libraries agree, then time them."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    data = make_data(args.seed, args.processes, args.points, args.queries, args.dims)
    compiled = {"plain JAX": plain_jax_process}
    compiled |= installed({"tinygp": ("tinygp", load_tinygp), "GPJax": ("gpjax", load_gpjax)})
    on_cpu = installed({"scikit-learn": ("sklearn", load_scikit_learn), "BoTorch": ("botorch", load_botorch)})
    compiled["bojax"] = bojax_process

    arguments = tuple(jnp.asarray(v) for v in (data.x, data.y, data.queries, data.lengthscales))
    results = {name: jax.jit(jax.vmap(process))(*arguments) for name, process in compiled.items()}
    results |= {name: processes(data) for name, processes in on_cpu.items()}
    check_agreement(results)

    rows = []
    for name, processes in on_cpu.items():
        seconds = median_seconds(lambda processes=processes: processes(data), args.repeats)
        rows.append(Row(name, args.processes, seconds, args.processes))
    lanes = {"all at once": args.processes}
    if not on_gpu():
        lanes = {"one by one": 1, f"{CPU_LANES} at once": CPU_LANES} | lanes
    for name, process in compiled.items():
        for how, number in lanes.items():
            rows.append(
                time_runs(
                    f"{name}, {how}",
                    lambda run, argument, process=process: process(*argument),
                    args.processes,
                    number,
                    1,
                    args.repeats,
                    prepare=lambda run: tuple(argument[run] for argument in arguments),
                )
            )

    title = f"GPs of {args.points} points in {args.dims}-D, fit and predict {args.queries}"
    print_rows(title, "GPs", rows, rows[0].what)
    print_ratios(rows, AIMS)
    if args.json:
        names = ("processes", "points", "queries", "dims", "seed", "repeats")
        write_record(args.json, "gp", "GPs", rows, {name: getattr(args, name) for name in names})
    return 0


def check_agreement(results: dict[str, tuple]) -> None:
    """Print the largest differences between bojax and the others.

    Raises:
        AssertionError: A difference is larger than rounding explains.
    """
    means, variances = results["bojax"]
    for name, (mean, variance) in results.items():
        if name == "bojax":
            continue
        off_mean, off_variance = np.max(np.abs(mean - means)), np.max(np.abs(variance - variances))
        print(f"bojax and {name} differ by {off_mean:.0e} in the means, {off_variance:.0e} in the variances")
        if not max(off_mean, off_variance) < 1e-6:
            raise AssertionError(f"{name}: not the same posterior")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
