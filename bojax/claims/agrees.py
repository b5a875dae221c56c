"""Test against a printed number: whether our mean or our share of runs agrees with it."""

from typing import Any

import numpy as np

from bojax.claims.samples import Measure, enough, flags, most_present, stand_ins
from bojax.claims.settings import Agrees
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding
from bojax.report.source import Results
from bojax.report.text import counted, number, percent

SHARE_TOLERANCE = 0.25
"""Default for a share: with 20 printed runs the interval reaches up to 0.22 beyond our own share."""


def agrees(results: Results, test: Agrees) -> Finding:
    """Whether our number may equal the printed one, and differs from it by less than a tolerance.

    The interval of the difference has to lie within the tolerance, and a test that both are equal must not
    reject: for means, Welch's interval then contains 0; for shares, Fisher's exact test decides, because
    Newcombe's interval excludes 0 too often for shares near 0 or 1 of few printed runs. The error of the
    printed number follows from its standard deviation or share and its number of runs. A printed deviation
    of 0 is replaced by ours: it says that no printed run differed from the others, not that none could.

    Runs without a value are left out if the claim allows it (`missing`): a mean printed over the successful
    runs is comparable with ours only if nearly all of our runs succeed.
    """
    label, name, runs = test.label, test.column, test.runs
    (point,), chosen = stand_ins(results, test, Measure(name))
    values = results.runs_of(point)[name]
    enough(values.size, "run")
    if test.share is not None:
        if test.missing and values.dtype.kind == "f":
            values = values[most_present(values, label, name, test.missing)]
            enough(values.size, "run")
        size, hits = values.size, int(flags(values, label, name).sum())
        printed = round(test.share * runs)
        interval = statistics.share_difference(hits, size, printed, runs)
        from scipy import stats  # takes half a second to import, and few reports need it

        result: Any = stats.fisher_exact([[hits, size - hits], [printed, runs - printed]])
        p_value = float(result.pvalue)
        is_apart = p_value < 2 * statistics.tail_in_use()
        estimate, tolerance = hits / size, test.tolerance or SHARE_TOLERANCE
        ours, theirs = percent(estimate), f"{percent(test.share)} of {counted(runs, 'run')}"
        what = f"Newcombe's 95% interval of the difference between our share of {name}"
        rule = f"Fisher's exact test must not tell the shares apart (p = {number(p_value)})"
    else:
        assert test.mean is not None and test.sd is not None  # the schema requires these or a share
        values = values[most_present(values, label, name, test.missing)].astype(np.float64)
        enough(size := values.size, "run")
        estimate, sd = float(values.mean()), float(values.std(ddof=1))
        interval = statistics.welch_difference((estimate, sd, size), (test.mean, test.sd or sd, runs))
        is_apart = interval.low > 0 or interval.high < 0
        tolerance = test.tolerance or test.sd
        ours = f"{number(estimate)} (sd {number(sd)}, {counted(size, 'run')})"
        theirs = f"{number(test.mean)} (sd {number(test.sd)}{'' if test.sd else ', taken as ours'}, "
        theirs += f"{counted(runs, 'run')})"
        what = f"Welch's 95% interval of the difference between our mean {name}"
        rule = "to contain 0"
    is_close = -tolerance < interval.low and interval.high < tolerance
    comparison = Comparison(f"{name} of {label} - thesis's", interval)
    return Finding(
        ours=estimate,
        verdict="not reproduced" if is_apart else "reproduced" if is_close else "inconclusive",
        comparisons=[comparison],
        decisive=comparison,
        runs=size,
        method=f"{what}, {ours}, and the thesis's, {theirs}: it has to lie within ±{tolerance:g}, and {rule}",
        chosen=chosen,
    )
