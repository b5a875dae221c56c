"""Test of a mean: whether it is above or below a threshold, or between two."""

from bojax.claims.samples import Measure, mean_of, stand_ins
from bojax.claims.settings import Mean
from bojax.report.findings import Comparison, Finding
from bojax.report.source import Results


def mean(results: Results, test: Mean) -> Finding:
    """Whether a mean is above a threshold, below one, or between two."""
    measure = Measure.of(test)
    (point,), chosen = stand_ins(results, test, measure)
    interval, runs, method = mean_of(results, test, point, measure)
    sides = {"above": test.above, "below": test.below}
    bounds = " and ".join(f"{side} {bound:g}" for side, bound in sides.items() if bound is not None)
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"{measure} of {test.label}", interval)],
        runs=runs,
        method=f"mean over runs of {measure}, 95% interval against {bounds}; {method}",
        chosen=chosen,
    )
