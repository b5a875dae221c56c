"""Test of a share: whether enough runs have a property, or few enough."""

import numpy as np
from numpy.typing import NDArray

from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding
from bojax.report.claims.samples import (
    Measure,
    Undecidable,
    by_episode,
    enough,
    episodes_in,
    finite,
    stand_ins,
)
from bojax.report.claims.settings import Share
from bojax.report.source import Point, Results
from bojax.report.text import counted


def share(results: Results, test: Share) -> Finding:
    """Whether the share of runs in which a condition holds is above, or below, a threshold."""
    label, limit, window = test.label, test.within, test.window
    (point,), chosen = stand_ins(results, test, Measure(test.column, window))
    if limit is not None and not point.ends_at_success:
        raise Undecidable(
            f"a run of {label} continues after its success, so its steps do not say when it succeeded"
        )
    if window is None:
        hits = results.runs_of(point)[test.column].astype(bool)
    else:
        hits = _in_any(results, point, test.column, window)
    condition = test.column
    if limit is not None:
        hits = hits & (results.runs_of(point)["steps"] <= limit)
        condition += f" within {counted(limit, 'step')}"
    if window is not None:
        condition += f" in {'' if window.first == window.last else 'any of '}{episodes_in(window)}"
    enough(hits.size, "run")
    interval = statistics.share_interval(hits)
    threshold = f"less than {test.below:g}" if test.above is None else f"more than {test.above:g}"
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"share of {label} with {condition}", interval)],
        runs=int(hits.size),
        method=f"Wilson 95% interval of the share of runs with {condition}, against {threshold}",
        chosen=chosen,
    )


def _in_any(results: Results, point: Point, name: str, window: Window) -> NDArray[np.bool_]:
    """Runs in which a column is true or not zero in some episode of a window.

    A run that ended within the window counts if it had such an episode before.
    """
    table = by_episode(results, point, name, window, results.runs_of(point)["run"])
    hits = (np.nan_to_num(table) != 0).any(axis=1)
    finite(np.where(hits, 0.0, table.mean(axis=1)), point.name, f"{name} in {episodes_in(window)}")
    return hits
