"""Figures of models: a Gaussian process, and a Bayesian optimisation."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation, OptimisationState, highest
from bojax.acquisition.functions import Acquisition
from bojax.api.results import Picture
from bojax.models.checks import by_name, check_count, check_kind, to_numbers
from bojax.models.estimators import GaussianProcessRegressor
from bojax.models.gaussian_process import GaussianProcess
from bojax.report import style
from bojax.report.statistics import BAND

NUM_POINTS = {1: 201, 2: 41}
"""Number of points along each dimension, by the number of dimensions."""


@dataclass(frozen=True)
class _Posterior:
    """What is drawn: a posterior on a grid of points, and the observations."""

    grid: np.ndarray  # `[M, D]`
    mean: np.ndarray  # `[M]`
    std: np.ndarray  # `[M]`
    draws: np.ndarray  # `[S, M]`
    score: np.ndarray | None  # `[M]`
    x: np.ndarray  # `[N, D]`
    y: np.ndarray  # `[N]`


def plot_gp(
    gp: GaussianProcess | GaussianProcessRegressor,
    low: Any = None,
    high: Any = None,
    *,
    samples: int = 0,
    acquisition: Acquisition | str | None = None,
    seed: int = 0,
) -> Picture:
    """Draw the mean and the uncertainty of a Gaussian process over one or two dimensions.

    Args:
        gp: The process, or a fitted estimator.
        low: Lower corner of the drawn box; by default the corner of the observations, with a margin.
        high: Upper corner.
        samples: Number of joint draws, on a line.
        acquisition: Acquisition function to draw too, an object or a name, such as `"log-ei"`.
        seed: Seed of the draws.

    Raises:
        ValueError: The estimator has not been fitted, the process has more than two dimensions, the box is
            empty or unknown, or an argument is of the wrong kind.
    """
    if isinstance(gp, GaussianProcessRegressor):
        if not hasattr(gp, "posterior_"):
            raise ValueError("GaussianProcessRegressor has not been fitted: call fit first")
        gp = gp.posterior_
    if not isinstance(gp, GaussianProcess):
        raise ValueError(
            f"gp: got {type(gp).__name__}; allowed: a GaussianProcess or a GaussianProcessRegressor"
        )
    count = int(gp.count)
    x, y = np.asarray(gp.x)[:count], np.asarray(gp.y)[:count]
    if not count and (low is None or high is None):
        raise ValueError("low, high: required for a process without observations")
    margin = 0.1 * np.ptp(x, axis=0) if count else 0.0
    low, high = (
        to_numbers(name, bound, gp.x.dtype)
        if bound is not None
        else jnp.asarray(edge(x, axis=0) + side * margin)
        for name, bound, edge, side in (("low", low, np.min, -1.0), ("high", high, np.max, 1.0))
    )
    grid = _grid(low, high, gp.x.shape[1], samples)
    acquisition = by_name("acquisition")(acquisition)
    if acquisition is not None:
        check_kind("acquisition", acquisition, Acquisition, "LogExpectedImprovement(0.01)")

    @eqx.filter_jit
    def evaluate(gp, acquisition, key, grid):
        mean, variance = gp.predict(grid)
        std = jnp.sqrt(variance)
        score = None if acquisition is None else acquisition(mean, std, highest(gp))
        return mean, std, gp.sample(key, grid, samples) if samples else jnp.zeros((0, len(grid))), score

    return _drawn(grid, evaluate(gp, acquisition, jax.random.key(seed), grid), x, y, "Gaussian process")


def plot_search(
    search: BayesianOptimisation, state: OptimisationState, *, samples: int = 0, seed: int = 0
) -> Picture:
    """Draw the posterior of an objective over its box of one or two dimensions, and the acquisition function.

    Args:
        search: The optimisation.
        state: Its state.
        samples: Number of joint draws of the objective, on a line.
        seed: Seed of the draws.

    Raises:
        ValueError: The box has more than two dimensions.
    """
    grid = _grid(search.low, search.high, len(search.low), samples)

    @eqx.filter_jit
    def evaluate(search, state, key, grid):
        draws = search.sample(key, state, grid, samples) if samples else jnp.zeros((0, len(grid)))
        return *search.predict(state, grid), draws, search.score(state, grid)

    count = int(state.model.count)
    x, y = (np.asarray(values)[:count] for values in search.observations(state))
    return _drawn(grid, evaluate(search, state, jax.random.key(seed), grid), x, y, "Bayesian optimisation")


def _grid(low: jax.Array, high: jax.Array, num_dims: int, samples: int) -> jax.Array:
    """Points of a box, row by row."""
    if num_dims not in NUM_POINTS:
        raise ValueError(f"a process of {num_dims} dimensions is not drawn; allowed: 1 or 2")
    check_count("samples", samples, 0)
    if num_dims > 1 and samples:
        raise ValueError(f"samples: got {samples}; draws are shown on a line, not in {num_dims} dimensions")
    if low.shape not in ((), (num_dims,)) or high.shape not in ((), (num_dims,)):
        raise ValueError(f"low, high: got shapes {low.shape} and {high.shape}; allowed: {num_dims} numbers")
    corners = np.stack([np.broadcast_to(bound, num_dims) for bound in (low, high)])
    if not np.all(corners[0] < corners[1]):
        raise ValueError(f"low, high: got {low.tolist()} and {high.tolist()}; allowed: low < high")
    axes = [np.linspace(a, b, NUM_POINTS[num_dims], dtype=low.dtype) for a, b in corners.T]
    return jnp.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, num_dims))


def _drawn(grid: jax.Array, evaluated: Any, x: np.ndarray, y: np.ndarray, title: str) -> Picture:
    mean, std, draws, score = (None if part is None else np.asarray(part) for part in evaluated)
    assert mean is not None and std is not None and draws is not None
    posterior = _Posterior(np.asarray(grid), mean, std, draws, score, x, y)
    with style.settings():
        if grid.shape[1] == 1:
            figure, caption = _draw_line(posterior)
        else:
            figure, caption = _draw_maps(posterior)
        png = style.encode(figure)["png"]
    alt = f"{title} with {len(y)} observations; its mean is between {mean.min():.3g} and {mean.max():.3g}."
    return Picture(figure, title, caption, alt, png)


def _draw_line(posterior: _Posterior):
    has_score = posterior.score is not None
    ratios = {"height_ratios": (3, 1)[: 1 + has_score]}
    height = 3.9 if has_score else 2.8
    figure, grid = style.figure(height, 1 + has_score, 1, sharex=True, gridspec_kw=ratios)
    axes, x, mean, band = grid[0, 0], posterior.grid[:, 0], posterior.mean, BAND * posterior.std
    shade = {"color": style.BLUE, "alpha": 0.18, "linewidth": 0, "label": "95%"}
    axes.fill_between(x, mean - band, mean + band, **shade)
    for i, draw in enumerate(posterior.draws):
        axes.plot(x, draw, color=style.SKY, linewidth=0.8, label="_" if i else "draws")
    axes.plot(x, mean, color=style.BLUE, label="mean")
    axes.scatter(posterior.x[:, 0], posterior.y, s=16, color=style.INK, zorder=3, label="observations")
    axes.set_ylabel("value")
    style.quiet_grid(axes)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
    if posterior.score is not None:
        below = grid[1, 0]
        below.plot(x, posterior.score, color=style.ORANGE)
        bottom, top = _shown(posterior.score)
        below.set_ylim(bottom - 0.05 * (top - bottom), top + 0.05 * (top - bottom))
        below.axvline(x[np.argmax(posterior.score)], color=style.FAINT, linewidth=0.8)
        below.set_ylabel("acquisition")
        style.quiet_grid(below)
    grid[-1, 0].set_xlabel("input")
    draws = f", {len(posterior.draws)} joint draws" if len(posterior.draws) else ""
    what = f"95% band of the noise-free function{draws}, and {len(posterior.y)} observations"
    return figure, _caption(what, "line", has_score)


def _draw_maps(posterior: _Posterior):
    panels = {"mean": posterior.mean, "standard deviation": posterior.std}
    if posterior.score is not None:
        panels["acquisition"] = posterior.score
    figure, grid = style.figure(2.5 * len(panels), len(panels), 1, sharex=True)
    side = NUM_POINTS[2]
    first, second = posterior.grid[::side, 0], posterior.grid[:side, 1]
    for axes, (name, values) in zip(grid[:, 0], panels.items(), strict=True):
        bottom, top = _shown(values) if name == "acquisition" else (None, None)
        drawn = {"cmap": "viridis", "rasterized": True, "vmin": bottom, "vmax": top}
        image = axes.pcolormesh(first, second, values.reshape(side, side).T, **drawn)
        axes.scatter(*posterior.x.T, s=14, color="white", edgecolors=style.INK, linewidths=0.6, zorder=3)
        axes.set_ylabel("second input")
        figure.colorbar(image, ax=axes, label=name)
    if posterior.score is not None:
        place = posterior.grid[np.argmax(posterior.score)]
        grid[-1, 0].scatter(*place, s=60, marker="x", color=style.ORANGE, zorder=4)
    grid[-1, 0].set_xlabel("first input")
    what = f"standard deviation of the noise-free function; {len(posterior.y)} observations"
    return figure, _caption(what, "cross", posterior.score is not None)


def _caption(what: str, mark: str, has_score: bool) -> str:
    below = f" Below: the acquisition function, cut off at its lower quartile; a {mark} marks its maximum."
    return f"Posterior mean and {what}.{below if has_score else ''}"


def _shown(score: np.ndarray) -> tuple[float, float]:
    """The range of the upper three quarters of the scores: a logarithm has no lower bound at observations."""
    bottom, top = float(np.quantile(score, 0.25)), float(np.max(score))
    return bottom, top if top > bottom else bottom + 1.0
