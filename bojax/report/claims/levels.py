"""Tests of one setting by itself: a share or a mean against a threshold, a mean that rises or falls."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap, within
from bojax.report.claims.samples import (
    Measure,
    Undecidable,
    by_episode,
    column,
    enough,
    episodes_in,
    finite,
    paired,
    score,
    stand_ins,
)
from bojax.report.source import Point, Results
from bojax.report.text import counted


def share(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether the share of runs in which a condition holds is above, or below, a threshold."""
    label, limit, window = test["label"], test.get("within"), test.get("window")
    measure = Measure(test["column"], window)
    (point,), chosen = stand_ins(results, test, [label], score(results, measure))
    if limit is not None and not point.ends_at_success:
        raise Undecidable(f"a run of {label} goes on after its success: steps do not tell when that was")
    if window is None:
        hits = np.asarray(column(results.runs_of(point), test["column"]), dtype=bool)
    else:
        hits = _in_any(results, point, test["column"], window)
    condition = test["column"]
    if limit is not None:
        hits = hits & (column(results.runs_of(point), "steps") <= limit)
        condition += f" within {counted(int(limit), 'step')}"
    if window is not None:
        condition += f" in {'' if window['from'] == window['to'] else 'any of '}{episodes_in(window)}"
    enough(hits.size, "run")
    interval = statistics.share_interval(hits)
    is_above = test.get("above") is not None
    threshold = test["above" if is_above else "below"]
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, **{"low" if is_above else "high": threshold}),
        comparisons=[(comparison := Comparison(f"share of {label} with {condition}", interval))],
        decisive=comparison,
        runs=int(hits.size),
        method=f"Wilson 95% interval of the share of runs with {condition}, against "
        f"{'more' if is_above else 'less'} than {threshold:g}",
        chosen=chosen,
    )


def mean(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether a mean is above a threshold, below one, or between two."""
    label, measure = test["label"], Measure.of(test)
    (point,), chosen = stand_ins(results, test, [label], score(results, measure))
    values = paired(results, [label], [point], measure)[:, 0]
    interval = statistics.mean_interval(values)
    bounds = {side: float(test[side]) for side in ("above", "below") if test.get(side) is not None}
    low, high = bounds.get("above", -float("inf")), bounds.get("below", float("inf"))
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, low, high),
        comparisons=[(comparison := Comparison(f"{measure} of {label}", interval))],
        decisive=comparison,
        runs=int(values.size),
        method=f"mean over runs of {measure}, 95% interval against "
        f"{' and '.join(f'{side} {bound:g}' for side, bound in bounds.items())}; {bootstrap(values.size)}",
        chosen=chosen,
    )


def trend(results: Results, test: Mapping[str, Any]) -> Finding:
    """Whether a mean falls, or rises, between two steps or between two windows of episodes.

    Between steps, a run that has ended keeps its last value, as in the figures.
    """
    label, direction = test["label"], test["direction"]
    first, last = (Measure(test["column"], test[end]) for end in ("from", "to"))
    (point,), chosen = stand_ins(results, test, [label], score(results, last))
    changes = np.subtract(*(paired(results, [label], [point], end)[:, 0] for end in (last, first)))
    interval = statistics.mean_interval(changes)
    between = f"from {_place(test['from'])} to {_place(test['to'])}"
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, **{"low" if direction == "rises" else "high": 0.0}),
        comparisons=[(comparison := Comparison(f"change of {label} {between}", interval))],
        decisive=comparison,
        runs=int(changes.size),
        method=f"mean change of {test['column']} {between} within a run, 95% interval "
        f"against 0 (the claim: it {direction}); {bootstrap(changes.size)}",
        chosen=chosen,
    )


def _in_any(
    results: Results, point: Point, name: str, window: Mapping[str, Any]
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Runs in which a column is true or not zero in some episode of a window.

    A run may have ended within the window, but then only after such an episode.
    """
    table = by_episode(results, point, name, window, results.runs_of(point)["run"])
    hits = (np.nan_to_num(table) != 0).any(axis=1)
    finite(np.where(hits, 0.0, table.mean(axis=1)), point.name, f"{name} in {episodes_in(window)}")
    return hits


def _place(place: Any) -> str:
    return f"step {place}" if isinstance(place, int) else episodes_in(place)
