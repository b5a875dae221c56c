"""The errors of bench_variance.py, computed in a process with its own cores."""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
from bench_variance import parse
from rich.console import Console
from rich.table import Table
from timing import describe_device

from bojax.models.bayesian_linear_regression import BayesianLinearRegression
from bojax.models.features import RandomFourier
from bojax.models.kernels import RBF

ALPHAS = (0.1, 0.01, 0.001)
BLOCK = 16
NUM_QUERIES = 500


def main(argv: list[str]) -> int:
    """Print the table."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(args.seed)
    lengthscale = jnp.full((3,), 0.3)
    features = RandomFourier.draw(jax.random.key(args.seed), RBF(lengthscale), args.features, 3)
    centres = rng.uniform(size=(args.clusters, 3))
    places = np.repeat(rng.integers(args.clusters, size=args.steps // 50 + 1), 50)[: args.steps]
    steps = centres[places] + 0.02 * rng.normal(size=(args.steps, 3))
    queries = np.concatenate([steps[-NUM_QUERIES // 2 :], rng.uniform(size=(NUM_QUERIES // 2, 3))])
    phi, psi = (np.asarray(features.design(jnp.asarray(x))) for x in (steps, queries))

    rows = []
    for alpha in ALPHAS:
        precision = alpha * np.eye(args.features) + phi.T @ phi
        exact = np.sum(psi * np.linalg.solve(precision, psi.T).T, axis=1)
        for dtype in ("float32", "float64"):
            for block in (0, BLOCK):
                found = np.asarray(learned(phi, psi, alpha, dtype, block), np.float64)
                relative = np.abs(found - exact) / exact
                absolute = np.abs(found - exact).max() * alpha
                rows.append((alpha, dtype, block, relative.max(), np.median(relative), absolute))
    table = Table(
        title=f"Variance after {args.steps:,} clustered steps, {args.features} features ({describe_device()})"
    )
    names = ("alpha", "precision", "block", "largest relative", "median relative", "largest, of 1/alpha")
    for name in names:
        table.add_column(name, justify="right")
    for alpha, dtype, block, *errors in rows:
        table.add_row(f"{alpha:g}", dtype, str(block), *(f"{error:.1e}" for error in errors))
    Console().print(table)
    if args.json:
        content = {"device": describe_device(), "rows": [dict(zip(names, row, strict=True)) for row in rows]}
        args.json.write_text(json.dumps(content, indent=2) + "\n")
    return 0


def learned(phi: np.ndarray, psi: np.ndarray, alpha: float, dtype: str, block: int) -> jax.Array:
    """Variances at the queries after one update for each step."""
    number = len(phi) // max(block, 1) * max(block, 1)
    rows = jnp.asarray(phi[:number], dtype).reshape(-1, max(block, 1), phi.shape[1])
    start = BayesianLinearRegression.prior(
        phi.shape[1], jnp.asarray(alpha, dtype), jnp.asarray(1.0, dtype), block=block
    )

    @jax.jit
    def run(start, rows):
        def some(posterior, some_rows):
            def one(i, posterior):
                step = i if block else None
                return posterior.update(some_rows[i], jnp.zeros((), dtype), step_in_block=step)

            return jax.lax.fori_loop(0, len(some_rows), one, posterior).flush(), None

        return jax.lax.scan(some, start, rows)[0]

    posterior = run(start, rows)
    for row in phi[number:]:
        posterior = posterior.update(jnp.asarray(row, dtype), jnp.zeros((), dtype)).flush()
    return posterior.predict(jnp.asarray(psi, dtype))[1]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
