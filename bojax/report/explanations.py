"""Why claims are not reproduced or inconclusive: explanations, with references filled in from results."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.config.references import Mean, OfClaim, Reference, matching, pieces
from bojax.report import statistics
from bojax.report.budgets import interval_of_times
from bojax.report.ranking import ENDS
from bojax.report.source import Point, Results
from bojax.report.text import MISSING, joined
from bojax.report.verdicts import FailureCause, TestedClaim, claims_among
from bojax.results.store import ResultsError

CAUSES: dict[FailureCause, str] = {
    "choice": "a choice that the thesis leaves open",
    "slip": "a slip of the thesis",
    "few-runs": "too few printed runs",
    "unexplained": "unexplained",
    "untested": "not tested",
}
"""Each cause in words."""

NOT_MEASURED = "(not measured here)"
"""Stands for a reference to results that are not at hand."""


@dataclass(frozen=True)
class AtHand:
    """Results of a sweep, with its claims."""

    results: Results
    claims: Sequence[TestedClaim]


@dataclass(frozen=True)
class Explained:
    """An explanation in these results."""

    cause: FailureCause
    text: str  # a paragraph; empty if the sweep has no explanation
    sweeps: Sequence[str]  # whose results are the evidence
    claims: Sequence[TestedClaim]  # that it explains and that are not reproduced, or inconclusive

    @property
    def cause_in_words(self) -> str:
        """The cause as pages show it."""
        return CAUSES[self.cause]


def explanations_of(own: AtHand, others: Mapping[str, AtHand]) -> list[Explained]:
    """The explanations of those claims that are not reproduced, or inconclusive, in the order of the sweep.

    Their references are filled in from the results of the sweep and of others, by name. Claims without an
    explanation come last: those that could not be tested, and those that are unexplained.
    """
    left = [claim for claim in own.claims if claim.verdict != "reproduced"]
    found = []
    for each in own.results.explanations:
        if members := [claim for claim in left if claim.id in each.claims]:
            text = _filled(each.text.strip(), own, others)
            found.append(Explained(each.cause, text, each.sweeps, members))
        left = [claim for claim in left if claim.id not in each.claims]
    untested = [claim for claim in left if claim.test.reason]
    unexplained = [claim for claim in left if not claim.test.reason]
    rest = Explained("unexplained", "", (), unexplained), Explained("untested", "", (), untested)
    return [*found, *(each for each in rest if each.claims)]


def causes_of(explanations: Iterable[Explained]) -> str:
    """How many claims have which cause, a sentence for each verdict; empty if all are reproduced."""
    pairs = [(claim.verdict, each.cause) for each in explanations for claim in claims_among(each.claims)]
    sentences = []
    for verdict in ("not reproduced", "inconclusive"):
        causes = [cause for of, cause in pairs if of == verdict]
        counts = [f"{causes.count(cause)} {text}" for cause, text in CAUSES.items() if cause in causes]
        if counts:
            sentences.append(f"Causes of the {len(causes)} {verdict}: {joined(counts)}.")
    return " ".join(sentences)


def _filled(text: str, own: AtHand, others: Mapping[str, AtHand]) -> str:
    try:
        found = [*pieces(text)]
    except ValueError:  # of an earlier version, in which braces had no meaning
        return text
    return "".join(each if isinstance(each, str) else _value(each, own, others) for each in found)


def _value(reference: Reference, own: AtHand, others: Mapping[str, AtHand]) -> str:
    source = others.get(reference.sweep) if reference.sweep else own
    if source is None:
        return NOT_MEASURED
    if isinstance(reference, OfClaim):
        claims = (claim for claim in source.claims if claim.id == reference.claim)
        return next((_of_claim(claim, reference) for claim in claims), NOT_MEASURED)
    points = matching(source.results.points, reference.point)
    try:
        return _mean(source.results, points[0], reference) if len(points) == 1 else NOT_MEASURED
    except ResultsError:  # a table or a column is missing
        return NOT_MEASURED


def _of_claim(claim: TestedClaim, reference: OfClaim) -> str:
    interval = claim.own_interval or " ".join(claim.decisive or ())
    texts = {"verdict": claim.verdict, "here": claim.found, "interval": interval, "share": claim.robustness}
    text = texts[reference.key]
    return NOT_MEASURED if text in ("", MISSING) else text


def _mean(results: Results, point: Point, reference: Mean) -> str:
    """A mean or a share with its interval, over the runs that have a value; `runs` is the number of runs."""
    if reference == Mean(reference.sweep, reference.point, "runs"):
        return f"{results.runs_of(point)['run'].size:,}"
    values = _values(results, point, reference)
    is_there = np.isfinite(values) if values.dtype.kind in "biuf" else np.zeros(values.shape, bool)
    if not is_there.any():
        return NOT_MEASURED
    is_share = values.dtype == bool
    of, rows = statistics.share_interval if is_share else statistics.mean_interval, results.runs_of(point)
    if (end := ENDS.get(reference.column)) is not None:
        of = interval_of_times(values, rows[end], np.where(is_there, values, rows[end]))
    text = " ".join(of(values[is_there]).in_words(as_percent=is_share))
    return text if is_there.all() else f"{text} in {is_there.sum():,} of {values.size:,} runs"


def _values(results: Results, point: Point, reference: Mean) -> NDArray[Any]:
    """The value of each run; empty if no run lasted so long."""
    if reference.step is not None:
        return results.by_step(point, reference.column)[:, reference.step : reference.step + 1].ravel()
    if reference.episodes is not None:
        first, last = reference.episodes
        table = results.by_episode(point, reference.column, reference.phase)
        return table[:, first - 1 : last].mean(axis=1) if last <= table.shape[1] else np.zeros(0)
    return results.runs_of(point)[reference.column]
