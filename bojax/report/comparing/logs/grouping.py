"""Chooses the column of logs that is compared, and groups runs by label."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bojax.config.errors import allowed_names, did_you_mean, listed
from bojax.report.comparing.curve_files import Rows
from bojax.report.comparing.logs.log import Log
from bojax.results.store import ResultsError

COLUMNS = {
    "train": {
        "return": ("r", "rollout/ep_rew_mean", "charts/episodic_return"),
        "length": ("l", "rollout/ep_len_mean", "charts/episodic_length"),
        "success": ("is_success", "rollout/success_rate"),
    },
    "test": {
        "return": ("results", "eval/mean_reward"),
        "length": ("ep_lengths", "eval/mean_ep_length"),
        "success": ("successes", "eval/success_rate"),
    },
}
"""Columns of Stable-Baselines3 and CleanRL, by phase and by the column of bojax that they correspond to."""


def rows_of(
    logs: Sequence[Log], metric: str, phase: str, axis: str, column: str | None
) -> list[tuple[Path, Rows]]:
    """The runs of logs by label, each label with the path that names its source.

    Runs keep the numbers in their names, unless one has none or two have the same: then they are counted.
    Without a column of the logs, it is one that corresponds to the metric, the column of bojax that is
    compared. Logs by step alone are refused where the axis is the episode.
    """
    groups: dict[tuple[str, Path | None], list[Log]] = {}
    for log in logs:
        groups.setdefault((log.label, log.group), []).append(log)
    found = []
    for (label, _), members in groups.items():
        numbers = [run for log in members if (run := log.run) is not None]
        if len({*numbers}) < len(members):
            numbers = [*range(len(members))]
        runs, columns = {}, []
        for run, log in sorted(zip(numbers, members, strict=True), key=lambda each: each[0]):
            columns.append(_chosen(log, metric, phase, column))
            curve = log.columns[columns[-1]]()
            if axis == "episode" and not curve.is_episodic:
                raise ResultsError(f"{log.path}: {columns[-1]} is logged by step; allowed: --x step")
            x = curve.steps if axis == "step" else np.arange(1.0, curve.values.size + 1)
            runs[run] = (x, curve.values)
        found.append((_source(members), Rows(label, "", runs, column=", ".join(dict.fromkeys(columns)))))
    return found


def _chosen(log: Log, metric: str, phase: str, column: str | None) -> str:
    """The column of a log: the given one, one of the name of the metric, one that corresponds to it."""
    if column is not None:
        if column not in log.columns:
            raise ResultsError(f"{log.path}: no column {column}{allowed_names(column, log.columns)}")
        return column
    test = COLUMNS["test"].get(metric, ())
    # Where a log has evaluations alone, these are its curve.
    known = test if phase == "test" else (metric, *COLUMNS["train"].get(metric, ()), *test)
    found = next((name for name in known if name in log.columns), None)
    if found is None and metric == "return" and phase == "train" and len(log.columns) == 1:
        (found,) = log.columns
    if found is None:
        raise ResultsError(
            f"{log.path}: no column for {metric}; allowed: --column NAME, with one of "
            f"{listed(metric, log.columns)}{did_you_mean(metric, log.columns)}"
        )
    return found


def _source(logs: Sequence[Log]) -> Path:
    """The path that was given for the runs, or the folder that all given paths have in common."""
    sources = list(dict.fromkeys(log.source for log in logs))
    return (
        sources[0] if len(sources) == 1 else Path(os.path.commonpath([os.path.abspath(p) for p in sources]))
    )
