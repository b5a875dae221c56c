"""Test of a mean: whether it is above or below a threshold, or between two."""

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding, bootstrap, within
from bojax.report.claims.samples import Measure, paired, score, stand_ins
from bojax.report.claims.settings import Mean
from bojax.report.source import Results


def mean(results: Results, test: Mean) -> Finding:
    """Whether a mean is above a threshold, below one, or between two."""
    label, measure = test.label, Measure.of(test)
    (point,), chosen = stand_ins(results, test, [label], score(results, measure))
    values = paired(results, [label], [point], measure)[:, 0]
    interval = statistics.mean_interval(values)
    sides = {"above": test.above, "below": test.below}
    bounds = [f"{side} {bound:g}" for side, bound in sides.items() if bound is not None]
    return Finding(
        ours=interval.estimate,
        verdict=within(interval, test.above, test.below),
        comparisons=[(comparison := Comparison(f"{measure} of {label}", interval))],
        decisive=comparison,
        runs=int(values.size),
        method=f"mean over runs of {measure}, 95% interval against "
        f"{' and '.join(bounds)}; {bootstrap(values.size)}",
        chosen=chosen,
    )
