"""Test of a mean: whether it is above or below a threshold, or between two."""

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap
from bojax.report.claims.samples import Measure, paired, stand_ins
from bojax.report.claims.settings import Mean
from bojax.report.source import Results


def mean(results: Results, test: Mean) -> Finding:
    """Whether a mean is above a threshold, below one, or between two."""
    measure = Measure.of(test)
    points, chosen = stand_ins(results, test, measure)
    interval = statistics.mean_interval(values := paired(results, test, points, measure)[:, 0])
    sides = {"above": test.above, "below": test.below}
    bounds = " and ".join(f"{side} {bound:g}" for side, bound in sides.items() if bound is not None)
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"{measure} of {test.label}", interval)],
        runs=len(values),
        method=f"mean over runs of {measure}, 95% interval against {bounds}; {bootstrap(len(values))}",
        chosen=chosen,
    )
