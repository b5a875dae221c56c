"""Test of the time that one advance of a single run takes: a step of a planner, an episode of a learner."""

from itertools import pairwise

from bojax.claims.samples import named
from bojax.claims.settings import Latency
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Results
from bojax.report.text import number


def latency(results: Results, test: Latency) -> Finding:
    """Whether the median time of an advance is below a bound, or how several compare.

    The interval of a median spans the least and the largest measured time; the interval of a ratio follows
    from the intervals of both medians.
    """
    times = {name: _measured(results, test, name) for name in test.labels}
    first = test.labels[0]
    if test.below is not None:
        comparisons = [Comparison(f"seconds of an advance of {first}", times[first])]
        bounds = None, test.below
        ours, claimed = times[first].estimate, f"below {test.below:g} s"
    else:
        others = [(first, name) for name in test.labels[1:]]
        comparisons = []
        for quick, slow in others if test.factor else pairwise(test.labels):
            a, b = times[quick], times[slow]
            ratio = statistics.Interval(b.estimate / a.estimate, b.low / a.high, b.high / a.low)
            comparisons.append(Comparison(f"{slow} / {quick}", ratio))
        bounds = (1.0 / test.factor, test.factor) if test.factor else (1.0, None)
        by_time = sorted(times.items(), key=lambda pair: pair[1].estimate)
        ours = " < ".join(f"{name} {number(time.estimate)} s" for name, time in by_time)
        claimed = f"ratios up to {test.factor:g}" if test.factor else "ratios above 1"
    return Finding.between(
        *bounds,
        comparisons,
        ours=ours,
        runs=1,
        method=f"median time of an advance of a single run on a {results.latency.kind}, "
        f"{results.latency.written[:10]}, and the range of the measured times, which contains it with 99% "
        f"confidence, against {claimed}",
        chosen={},
    )


def _measured(results: Results, test: Latency, name: str) -> statistics.Interval:
    """Median, least and largest time of the point of a name."""
    points = named(results, test, name)
    if len(points) > 1:
        raise Undecidable(f"several settings of {name}: test them by variant")
    seconds = results.latency.seconds.get(str(points[0].index))
    if seconds is None:
        raise Undecidable(  # a page for others repeats this text, so that it names no folder
            f"the latency of {name} was not measured: run `bojax bench latency DIR` on the results, "
            "then report again"
        )
    return statistics.Interval(*seconds)
