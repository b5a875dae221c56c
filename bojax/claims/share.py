"""Test of a share: whether enough runs have a property, or few enough."""

from bojax.claims.samples import Measure, enough, episodes_in, in_any, stand_ins
from bojax.claims.settings import Share
from bojax.report import statistics
from bojax.report.findings import Comparison, Finding, Undecidable
from bojax.report.source import Results
from bojax.report.text import counted


def share(results: Results, test: Share) -> Finding:
    """Whether the share of runs in which a condition holds is above, or below, a threshold."""
    label, limit, window = test.label, test.within, test.window
    (point,), chosen = stand_ins(results, test, Measure(test.column, window))
    if limit is not None and not point.ends_at_success:
        raise Undecidable(
            f"a run of {label} continues after its success, so its steps do not say when it succeeded"
        )
    if window is None:
        hits = results.runs_of(point)[test.column].astype(bool)
    else:
        hits = in_any(results, point, test.column, window)
    condition = test.column
    if limit is not None:
        hits = hits & (results.runs_of(point)["steps"] <= limit)
        condition += f" within {counted(limit, 'step')}"
    if window is not None:
        condition += f" in {'' if window.first == window.last else 'any of '}{episodes_in(window)}"
    enough(hits.size, "run")
    interval = statistics.share_interval(hits)
    threshold = f"less than {test.below:g}" if test.above is None else f"more than {test.above:g}"
    return Finding.between(
        test.above,
        test.below,
        [Comparison(f"share of {label} with {condition}", interval)],
        runs=int(hits.size),
        method=f"Wilson 95% interval of the share of runs with {condition}, against {threshold}",
        chosen=chosen,
    )
