"""Random actions beside a learner, as curves of the figures over episodes; see `bojax.engine.baseline`."""

from dataclasses import dataclass, replace

import numpy as np

from bojax.experiments.settings import Learning
from bojax.report.columns import read_columns, where
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.results.baseline import FILE

NOTE = "Random actions learn nothing, and are drawn for comparison; held ones are repeated for 8 steps."


@dataclass(frozen=True, eq=False)
class Baseline:
    """The episodes of random actions that are repeated for the same number of steps."""

    point: Point  # which gives its curve a name and a colour
    success: Floats  # `[runs, episodes]`, 0 or 1
    returns: Floats  # `[runs, episodes]`; where a learner's run ends at its first success, held from there on

    @property
    def first(self) -> Floats:
        """Number of the first episode with a success of each run, NaN for never."""
        return np.where(self.success.any(axis=1), 1.0 + self.success.argmax(axis=1), np.nan)


def baselines(results: Results) -> list[Baseline]:
    """The baselines of a results folder; empty if it has none."""
    path = results.folder / FILE
    if not path.exists():
        return []
    table, (point, *_) = read_columns(path), results.points
    ends = isinstance(point.experiment, Learning) and point.experiment.stop == "first-success"
    found = []
    for repeat in np.unique(table["action_repeat"]):
        own = where(table, action_repeat=repeat)
        shape = np.unique(own["run"]).size, -1
        success, returns = (own[name].astype(np.float64).reshape(shape) for name in ("success", "return"))
        if ends:
            last = np.where(success.any(axis=1), success.argmax(axis=1), success.shape[1] - 1)
            places = np.minimum(np.arange(success.shape[1]), last[:, None])
            returns = np.take_along_axis(returns, places, axis=1)
        name = "random actions" if repeat == 1 else "random actions, held"
        found.append(Baseline(replace(point, label="random", variant=name, name=name), success, returns))
    return found
