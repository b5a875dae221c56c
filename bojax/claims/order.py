"""Test of an order: whether means are in the order that a claim states."""

import dataclasses
from itertools import pairwise, product

import numpy as np

from bojax.claims.samples import Measure, episodes_in, interval_of, paired, refuse_any_share, stand_ins
from bojax.claims.settings import Order
from bojax.config.claims import Window
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding
from bojax.report.source import Results
from bojax.report.text import counted, number


def order(results: Results, test: Order) -> Finding:
    """Whether the means of a column are in the given order, each above (or below) the next.

    Runs with the same index share their key, so neighbours are compared by the mean difference of paired
    runs, one-sided in both directions, with Holm's correction over the pairs. With a margin, a mean may fall
    short of the next by that amount, or by that share of the lead of the next over a baseline
    (non-inferiority). With a negative margin it has to exceed the next by that much. With several `parts` of
    a window, all of this has to hold in each of them, as of curves that do not cross.
    """
    measure = dataclasses.replace(Measure.of(test), missing=test.censored_at)
    margin, baseline = test.margin, test.baseline
    sign, tiers = (-1.0 if test.greater is None else 1.0), test.tiers
    points, chosen = stand_ins(results, test, measure, sign)
    table = paired(results, test, points, measure)
    is_share = measure.is_share(results)
    if is_share and baseline is None:
        refuse_any_share(margin)
    numbers = np.asarray(table, dtype=np.float64)
    values = dict(zip(test.names, numbers.T, strict=True))
    pairs = [pair for above, below in pairwise(tiers) for pair in product(above, below)]
    parts = _parts(measure, test.parts)
    constant = 0.0 if baseline is not None else margin

    def sums(rows: statistics.Floats) -> statistics.Floats:
        """Of rows with a value per name: what has to be positive in the mean, less the constant."""
        column = dict(zip(test.names, rows.T, strict=True))
        leads = [sign * (column[a] - column[b]) for a, b in pairs]
        if baseline is not None:
            leads = [
                lead + margin * (sign * (column[b] - column[baseline]))
                for lead, (_, b) in zip(leads, pairs, strict=True)
            ]
        return np.stack(leads, axis=1)

    tables = [numbers] if len(parts) == 1 else [paired(results, test, points, part) for part in parts]
    sample = np.concatenate([sums(table.astype(np.float64)) for table in tables], axis=1) + constant
    weights = sums(np.eye(len(test.names))).T  # sums of unit vectors

    def share_bounds(pair: int, tail: float) -> tuple[float, float]:
        found = statistics.paired_shares(numbers, weights[pair], tail)
        return found.low + constant, found.high + constant

    comparisons = []
    intervals = statistics.holm_intervals(sample, share_bounds if is_share else None)
    for (part, (a, b)), interval in zip(product(parts, pairs), intervals, strict=True):
        of = _difference(a, b, sign)
        if margin:
            allowance = f" ({_difference(b, baseline, sign)})" if baseline is not None else ""
            of += f" {'+' if margin > 0 else '-'} {abs(margin):g}{allowance}"
        if len(parts) > 1 and isinstance(part.place, Window):
            of += f" in {episodes_in(part.place)}"
        comparisons.append(Comparison(of, interval))
    within = f" in each of {len(parts)} equal parts" if len(parts) > 1 else ""
    by_mean = sorted((name for tier in tiers for name in tier), key=lambda name: -sign * values[name].mean())
    return Finding.between(
        0.0,
        None,
        comparisons,
        ours=(" > " if sign > 0 else " < ").join(f"{name} {number(values[name].mean())}" for name in by_mean),
        runs=len(table),
        method=f"mean difference of {measure} between paired runs{' plus the margin' if margin else ''}, "
        f"each pair of neighbours{within}, one-sided at {statistics.tail_in_use():.1%} with Holm's "
        f"correction over {counted(len(comparisons), 'pair')}, intervals at the corrected levels; "
        f"{interval_of(len(table), is_share=is_share)}",
        chosen=chosen,
    )


def _parts(measure: Measure, number: int) -> list[Measure]:
    """The measure in each of so many equal parts of its window."""
    window = measure.place
    if number == 1 or not isinstance(window, Window):
        return [measure]
    length = (window.last - window.first + 1) // number
    starts = range(window.first, window.last + 1, length)
    windows = [window.model_copy(update={"first": start, "last": start + length - 1}) for start in starts]
    return [dataclasses.replace(measure, place=each) for each in windows]


def _difference(a: str, b: str, sign: float) -> str:
    return f"{a} - {b}" if sign > 0 else f"{b} - {a}"
