"""Test against a printed number: whether our mean or our share of runs agrees with it."""

import numpy as np

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, within
from bojax.report.claims.samples import Measure, column, enough, most_present, score, stand_ins
from bojax.report.claims.settings import Agrees
from bojax.report.source import Results
from bojax.report.text import counted, number, percent

SHARE_TOLERANCE = 0.25
"""Default for a share: with 20 printed runs the interval reaches up to 0.22 beyond our own share."""


def agrees(results: Results, test: Agrees) -> Finding:
    """Whether the interval of the difference to a printed number contains 0 and lies within a tolerance.

    Runs without a value are left out if the claim allows it (`missing`): a mean printed over the
    successful runs is comparable with ours only if nearly all of our runs succeed. The error of the printed
    number follows from its standard deviation or share and its number of runs.
    """
    label, name, runs = test.label, test.column, test.runs
    (point,), chosen = stand_ins(results, test, [label], score(results, Measure(name)))
    values = column(results.runs_of(point), name)
    enough(values.size, "run")
    if test.share is not None:
        printed, hits = test.share, np.asarray(values, dtype=bool)
        interval = statistics.share_difference(int(hits.sum()), hits.size, printed * runs, runs)
        tolerance = SHARE_TOLERANCE if test.tolerance is None else test.tolerance
        ours, theirs = percent(hits.mean()), f"{percent(printed)} of {counted(runs, 'run')}"
        what = f"Newcombe's 95% interval of the difference between our share of {name}"
        estimate, size = float(hits.mean()), int(hits.size)
    else:
        assert test.mean is not None and test.sd is not None  # the schema requires these or a share
        printed, sd = test.mean, test.sd
        values = values[most_present(values, label, name, test.missing)].astype(np.float64)
        enough(values.size, "run")
        estimate, size = float(values.mean()), int(values.size)
        ours_sd = float(values.std(ddof=1))
        interval = statistics.welch_difference((estimate, ours_sd, size), (printed, sd, runs))
        tolerance = sd if test.tolerance is None else test.tolerance
        ours = f"{number(estimate)} (sd {number(ours_sd)}, {counted(size, 'run')})"
        theirs = f"{number(printed)} (sd {number(sd)}, {counted(runs, 'run')})"
        what = f"Welch's 95% interval of the difference between our mean {name}"
    is_apart = interval.low > 0 or interval.high < 0
    return Finding(
        ours=estimate,
        verdict="not reproduced" if is_apart else within(interval, -tolerance, tolerance),
        comparisons=[(comparison := Comparison(f"{name} of {label} - thesis's", interval))],
        decisive=comparison,
        runs=size,
        method=f"{what}, {ours}, and the thesis's, {theirs}: it has to contain 0 and to lie within "
        f"±{tolerance:g}",
        chosen=chosen,
    )
