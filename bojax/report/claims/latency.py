"""Test of the time that one advance of a single run takes: a step of a planner, an episode of a learner."""

from itertools import pairwise

from bojax.report import statistics
from bojax.report.claims.finding import Comparison, Finding
from bojax.report.claims.samples import Undecidable, named
from bojax.report.claims.settings import Latency
from bojax.report.source import Results
from bojax.report.text import number


def latency(results: Results, test: Latency) -> Finding:
    """Whether the median time of an advance is below a bound, or whether several are in the claimed order.

    The interval of a median is that between the least and the largest measured time; the interval of a ratio
    follows from those of both medians.
    """
    times = [_measured(results, test, name) for name in test.labels]
    if test.below is not None:
        (interval,) = times
        comparisons = [Comparison(f"seconds of an advance of {test.labels[0]}", interval)]
        bounds = None, test.below
        ours, claimed = interval.estimate, f"below {test.below:g} s"
    else:
        comparisons = [
            Comparison(
                f"{slow} / {quick}",
                statistics.Interval(b.estimate / a.estimate, b.low / a.high, b.high / a.low),
            )
            for (quick, a), (slow, b) in pairwise(zip(test.labels, times, strict=True))
        ]
        bounds = 1.0, None
        by_time = sorted(zip(times, test.labels, strict=True), key=lambda pair: pair[0].estimate)
        ours = " < ".join(f"{name} {number(time.estimate)} s" for time, name in by_time)
        claimed = "ratios above 1"
    return Finding.between(
        *bounds,
        comparisons,
        ours=ours,
        runs=1,
        method="median time of an advance of a single run on this machine, and the range of the measured "
        f"times, which contains it with at least 97% confidence, against {claimed}",
        chosen={},
    )


def _measured(results: Results, test: Latency, name: str) -> statistics.Interval:
    """Median, least and largest time of the point of a name."""
    points = named(results, test, name)
    if len(points) > 1:
        raise Undecidable(f"several settings of {name}: test them by variant")
    key = str(points[0].index)
    for group in results.manifest.groups:
        median, ends = (group.latency_seconds or {}).get(key), (group.latency_range or {}).get(key)
        if median is not None and ends is not None:
            return statistics.Interval(median, *ends)
    raise Undecidable(f"the latency of {name} was not measured: set engine.latency to true")
