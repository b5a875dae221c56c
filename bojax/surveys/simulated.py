"""A config of `bojax run` that simulates a survey: planners drive on a field that the model expects."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from bojax.areas.place import Place
from bojax.config.yaml_file import dump
from bojax.results.store import write_content
from bojax.surveys.model import FieldModel
from bojax.surveys.planning import Demand, Survey

CONFIG, FIELD = "simulation.yaml", "field.csv"
"""The config, and the values of the field."""

CELLS = 40
"""Cells of the longer side of the field."""

PATH_SAMPLES = 5
"""Measurements along a path of one lengthscale, the action of a planner."""

_COMMENT = "# bojax run simulates this survey. The domain is the rectangle around the area, holes included.\n"

ROOM = 1.5
"""Paths for which there is room, relative to those that use the budget: walls and borders shorten some."""


def write_simulation(
    folder: Path, place: Place, model: FieldModel, survey: Survey, demand: Demand
) -> list[Path]:
    """Write the config and its field, and return the paths; nothing for several robots.

    Without an earlier survey, the field is one that the model draws; with one, it is what the earlier survey
    makes the model expect. Its domain is the rectangle around the area: the tree planners know walls, but no
    outlines.
    """
    if demand.robots > 1:
        return []
    bounds = place.area.bounds
    rows = [",".join(f"{value:.6g}" for value in row) for row in _values(model, bounds)]
    write_content(folder / FIELD, "\n".join(rows) + "\n")
    length = demand.budget or survey.chosen.length
    path = min(model.lengthscale, length / 2.0)
    x, y = survey.chosen.routes[0][0]
    origin = "what the earlier survey expects" if model.seen is not None else "a draw from the model"
    content: dict[str, Any] = {
        "title": f"Simulated survey of {Path(place.name).name}, on {origin}",
        "problem": {
            "kind": "monitoring",
            "field": {"kind": "grid", "file": str(folder / FIELD), "extent": list(bounds)},
            "domain": list(bounds),
            "start": [float(x), float(y), 0.0],
            "objective": "uncertainty",
            "mean": {"kind": "constant", "value": model.mean},
            "kernel": {
                "kind": "scaled",
                "kernel": {"kind": "matern52", "lengthscale": model.lengthscale},
                "variance": model.std**2,
            },
            "noise": model.noise,
            "noise_variance": model.noise**2,
            "exit_reward": -PATH_SAMPLES * model.std,
            "budget": length,
            "max_steps": math.ceil(ROOM * length / path),
            "errors_by_step": True,
        },
        "planner": {
            "kind": "sbo",
            "iterations": 100,
            "exploration": 10.0 * model.std,
            "motions": {"kind": "splines", "actions": 9, "length": path, "num_samples": PATH_SAMPLES},
        },
        "runs": 8,
    }
    write_content(folder / CONFIG, _COMMENT + dump(content))
    return [folder / CONFIG]


def _values(model: FieldModel, bounds: tuple[float, float, float, float]) -> np.ndarray:
    """Values `[rows, columns]` on a grid over the bounds, the first row at the lowest y."""
    x_min, y_min, x_max, y_max = bounds
    spacing = max(x_max - x_min, y_max - y_min) / CELLS
    x, y = (
        np.linspace(low, high, max(2, round((high - low) / spacing) + 1))
        for low, high in ((x_min, x_max), (y_min, y_max))
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    if model.seen is not None:
        values = model.predict(points)[0]
    else:
        scaled = np.sqrt(5.0) * cdist(points, points) / model.lengthscale
        covariance = model.std**2 * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
        factor = np.linalg.cholesky(covariance + 1e-8 * model.std**2 * np.eye(len(points)))
        values = model.mean + factor @ np.random.default_rng(0).standard_normal(len(points))
    return values.reshape(len(y), len(x))
