"""Logs in `.npz` files: evaluations of Stable-Baselines3, and score matrices as rliable takes them."""

import zipfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bojax.report.comparing.curve_files import Rows
from bojax.report.comparing.logs.log import LARGEST_VALUE, Columns, Logged, logged
from bojax.results.store import ResultsError

_EVALUATIONS = ("results", "ep_lengths", "successes")  # arrays `[evaluations, episodes]`
_TASKS = ("tasks", "games")  # names of an array with the names of the columns of all matrices


def arrays_of(path: Path) -> dict[str, Any]:
    """The arrays of a `.npz` file; pickled objects are refused."""
    allowed = 'allowed: arrays of numbers, as np.savez("scores.npz", **scores) writes them'
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ResultsError(f"{path}: has a single array; {allowed}")
            return {name: file[name] for name in file.files}
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError):
        raise ResultsError(f"{path}: cannot be read without unpickling, or is damaged; {allowed}") from None


def evaluation_columns(path: Path, arrays: Mapping[str, Any]) -> Columns:
    """The columns of `evaluations.npz`: means over the episodes of each evaluation."""

    def read(name: str) -> Logged:
        steps, values = _numbers(path, "timesteps", arrays["timesteps"]), _numbers(path, name, arrays[name])
        if values.ndim == 0 or steps.ndim != 1 or len(values) != steps.size:
            raise ResultsError(
                f"{path}: {name}: got shape {values.shape}; allowed: a row for each of {steps.size} timesteps"
            )
        return logged(f"{path}: {name}", steps, values.reshape(steps.size, -1).mean(axis=1))

    return {name: partial(read, name) for name in _EVALUATIONS if name in arrays}


def score_rows(path: Path, arrays: Mapping[str, Any]) -> list[Rows]:
    """The methods of score matrices `[runs, tasks]`, or `[runs]`, by name: a value for each run and task.

    Tasks, the same for all matrices, are numbered from 1, or named by an array `tasks` or `games`.
    """
    named = next((arrays[name] for name in _TASKS if name in arrays), None)
    matrices = {name: _numbers(path, name, array) for name, array in arrays.items() if name not in _TASKS}
    if not matrices:
        raise ResultsError(f"{path}: has no scores; allowed: an array [runs, tasks] for each method")
    rows, first = [], next(iter(matrices))
    for name, matrix in matrices.items():
        if matrix.ndim not in (1, 2) or not matrix.size:
            raise ResultsError(f"{path}: {name}: got shape {matrix.shape}; allowed: [runs, tasks] or [runs]")
        if (wrong := ~(np.abs(matrix) <= LARGEST_VALUE)).any():
            raise ResultsError(f"{path}: {name}: got {matrix[wrong][0]:g}; allowed: finite numbers")
        if matrix.shape[1:] != matrices[first].shape[1:]:
            raise ResultsError(
                f"{path}: {name}: got shape {matrix.shape}; allowed: the tasks of {first}, whose shape is "
                f"{matrices[first].shape}"
            )
        columns = matrix.reshape(len(matrix), -1).T
        tasks = [f"task {place}" for place in range(1, len(columns) + 1)] if matrix.ndim == 2 else [""]
        if named is not None:
            tasks = [str(task) for task in np.ravel(named)]
        if len({*tasks}) != len(columns):
            raise ResultsError(
                f"{path}: tasks: got {len({*tasks})} different names; allowed: {len(columns)}, one for each "
                f"column of {name}"
            )
        for task, scores in zip(tasks, columns, strict=True):
            runs = {run: (np.zeros(1), np.array([score])) for run, score in enumerate(scores)}
            rows.append(Rows(name, task, runs, has_curve=False))
    return rows


def _numbers(path: Path, name: str, array: Any) -> Any:
    if array.dtype.kind not in "buif":
        raise ResultsError(f"{path}: {name}: got {array.dtype}; allowed: numbers")
    return array.astype(np.float64)
