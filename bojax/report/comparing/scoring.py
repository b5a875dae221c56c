"""Scores of the methods of a comparison at one budget, their curves, and the methods by task."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bojax.config.errors import allowed_names
from bojax.report.budgets import common_budget, times_within
from bojax.report.comparing.methods import Measure, Method
from bojax.report.drawing.curves import ANY, Curve
from bojax.report.ranking import ENDS
from bojax.report.text import counted, printed
from bojax.results.store import ResultsError

GRID = 200  # number of places at which curves over the steps of an environment are drawn


@dataclass(frozen=True)
class Task:
    """The methods on one problem or environment."""

    name: str  # empty if nothing says which
    methods: Sequence[Method]
    reference: Method  # the one that others are compared with


def tasks_of(methods: Sequence[Method], measure: Measure, reference: str | None) -> list[Task]:
    """Methods by task, with scores; the reference is the one of this name, otherwise the first."""
    names = {each.name for each in methods}
    reference = None if reference is None else printed(reference)
    if reference is not None and reference not in names:
        raise ResultsError(f"--reference: got {reference}{allowed_names(reference, names)}")
    tasks = []
    for name in dict.fromkeys(each.task for each in methods):
        members = scored([each for each in methods if each.task == name], measure)
        chosen = next((each for each in members if each.name == reference), members[0])
        tasks.append(Task(printed(name) if name else "", members, chosen))
    return tasks


def scored(methods: Sequence[Method], measure: Measure) -> list[Method]:
    """Methods of one task with their scores and curves.

    Scores are those at the largest budget that all methods have, or at the given one.

    Raises:
        ResultsError: The given budget is beyond the budget of a method, or before the first value of a run.
    """
    budget = common_budget([each.series for each in methods])
    if measure.options.at is not None:
        _check_place(methods, measure)
        budget = float(measure.options.at)
    longest = max(run.end for each in methods for run in each.series)
    found = []
    for each in methods:
        if not each.has_curve:
            values = np.array([run.values[-1] for run in each.series], dtype=np.float64)
            scores = times_within(values, budget) if measure.column in ENDS else values
        else:
            last = measure.options.last or (1 if measure.kind == "planning" else None)
            scores = np.array([run.score(budget, last) for run in each.series])
        scores = np.where(each.has_nan, np.nan, scores)
        curve = _curve(each, measure, min(each.budget, longest)) if each.has_curve else None
        found.append(replace(each, scores=scores, at=budget, curve=curve))
    return found


def _check_place(methods: Sequence[Method], measure: Measure) -> None:
    at = measure.options.at
    assert at is not None
    for each in methods:
        if not each.has_curve and measure.column not in ENDS:
            raise ResultsError(f"--at: got {at}; {measure.column} has one value per run, at its end")
        if at > each.budget:
            raise ResultsError(
                f"--at: got {at}; {each.name} has {counted(int(each.budget), measure.unit)}; allowed: <= "
                f"{int(each.budget)}"
            )
        first = max((run.x[0] for run in each.series if run.x.size), default=0.0)
        if each.has_curve and at < first:
            raise ResultsError(
                f"--at: got {at}; a run of {each.name} has its first value at {measure.unit} {first:g}; "
                f"allowed: >= {math.ceil(first)}"
            )


def _curve(method: Method, measure: Measure, end: float) -> Curve:
    """Values of the runs at common places up to a step or episode."""
    if measure.kind == "planning":
        places = np.arange(end + 1)
    elif measure.axis == "episode":
        places = np.unique(np.concatenate([[end], *(run.x for run in method.series)]))
    else:
        spacing = max(1.0, np.ceil(end / GRID))
        places = np.unique(np.append(np.arange(spacing, end + 1, spacing), end))
    values = [run.at(places) for run, bad in zip(method.series, method.has_nan, strict=True) if not bad]
    values = np.reshape(values, (-1, places.size))
    return Curve(method.point, places, values, (0, 1) if method.is_rate else ANY)
