"""Test of how a mean grows with a swept number: linearly, quadratically or exponentially."""

from typing import Any

import numpy as np

from bojax.claims.samples import bootstrap, enough, most_present, named
from bojax.claims.settings import Growth
from bojax.report import growth as laws
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Results
from bojax.report.statistics import Floats
from bojax.report.text import counted, percent
from bojax.report.verdicts import Verdict

MIN_NUMBERS = 4  # smallest number of means: two coefficients fit two means exactly and three nearly


def growth(results: Results, test: Growth) -> Finding:
    """Which law of `bojax.report.growth` fits the means best, and with what confidence.

    Whole runs are resampled, with the same indices for every number. The verdict is decided if one law fits
    best in 95% of the resamples.
    """
    label, name, over, expected = test.label, test.column, test.over, test.expected
    x, values = _samples(results, test)
    is_there = np.isfinite(values)
    means = statistics.bootstrap_present(values)
    low, high = statistics.central(means[:, -1] - means[:, 0])
    if not low > 0:
        raise Undecidable(
            f"the mean {name} of {label} does not clearly grow: from {over} {x[0]:g} to {x[-1]:g} it "
            f"changes by between {low:g} and {high:g}"
        )
    ours, errors = np.nanmean(values, axis=0), laws.errors_of(values)
    fits = {law: laws.fit(law, x, ours, errors) for law in laws.LAWS}
    resampled = {law: laws.fit(law, x, means, errors).misfit for law in laws.LAWS}
    wins = np.bincount(np.argmin(list(resampled.values()), axis=0), minlength=len(laws.LAWS)) / len(means)
    shares = dict(zip(laws.LAWS, wins, strict=True))
    comparisons, tiny = [], np.finfo(np.float64).tiny
    for law in laws.LAWS:
        if law != expected:
            ratio = float(fits[law].misfit / max(fits[expected].misfit, tiny))
            ratios = resampled[law] / np.maximum(resampled[expected], tiny)
            interval = statistics.Interval(ratio, *statistics.central(ratios))
            comparisons.append(Comparison(f"misfit of {law} / misfit of {expected}", interval))
    best = max(shares, key=lambda law: shares[law])
    verdict: Verdict = "inconclusive"
    if shares[best] >= 1 - 2 * statistics.tail_in_use():
        verdict = "reproduced" if best == expected else "not reproduced"
    off = float(np.sqrt(np.mean((fits[best](x) / ours - 1) ** 2)))
    told = ", ".join(f"{fit.law} {fit} in {percent(shares[fit.law])}" for fit in fits.values())
    lacking = int((~is_there).sum())
    power = ""
    if x[0] > 0 and means.min() > 0:
        # For a power law, log(mean) is linear in log(x), and errors become relative ones.
        exponent, *many = laws.fit("linear", np.log(x), np.log(np.vstack([ours, means])), errors / ours).b
        low, high = statistics.central(np.asarray(many))
        power = f"; exponent of a power law: {exponent:.2f} [{low:.2f}, {high:.2f}]"
    left_out = f"; {counted(lacking, 'run')} without a value left out" if lacking else ""
    return Finding(
        ours=f"{best}: {fits[best]}",
        verdict=verdict,
        comparisons=comparisons,
        decisive=min(comparisons, key=lambda comparison: comparison.interval.estimate),
        runs=len(values),
        method=f"mean {name} over {over} x of {', '.join(f'{number:g}' for number in x)}, each with its "
        f"standard error and {laws.FLOOR:.0%} of it, fitted by weighted least squares; share of "
        f"resamples in which each law fits best: {told} (95% decide); relative root mean square error of the "
        f"best fit {percent(off)}{power}{left_out}; {bootstrap(len(values))}",
    )


def _samples(results: Results, test: Growth) -> tuple[Floats, Floats]:
    """The swept numbers `[n]`, the least first, and the value of each run at each of them, `[runs, n]`."""
    label, over = test.label, test.over
    points = named(results, test, label)
    numbers: list[Any] = [point.swept.get(over) for point in points]
    if not all(isinstance(number, int | float) for number in numbers):
        raise Undecidable(f"{over} is not a swept number of {label}")
    by_number = dict(zip(numbers, points, strict=True))
    if len(by_number) < len(points):
        raise Undecidable(f"several settings of {label} have the same {over}: test them by variant")
    if len(by_number) < MIN_NUMBERS:
        raise Undecidable(f"{counted(len(by_number), 'value')} of {over}: at least {MIN_NUMBERS} are needed")
    x = np.array(sorted(by_number), dtype=np.float64)
    table = results.paired([by_number[number] for number in x], test.column).astype(np.float64)
    enough(len(table), "paired run")
    for number, values in zip(x, table.T, strict=True):
        present = most_present(values, f"{label} at {number:g}", test.column, test.missing)
        enough(int(present.sum()), "successful run")
    if not (np.nanmean(table, axis=0) > 0).all():
        raise Undecidable(f"the means of {test.column} are not positive: no law of growth holds")
    return x, table
