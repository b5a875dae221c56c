"""Share of runs that have succeeded by each step, with Wilson bands."""

from bojax.report.drawing.base import Drawing, Undrawable, drawn_points
from bojax.report.drawing.curves import draw_curves
from bojax.report.drawing.success import ends, success_curves
from bojax.report.source import Results

RANK = 20


def draw(results: Results) -> Drawing:
    """Success by step: a run succeeds at its last step or never."""
    runs = results.runs
    if "success" not in runs or "steps" not in runs or not runs["steps"].size:
        raise Undrawable("runs.parquet has no success and steps")
    points, note = drawn_points(results)
    if not all(point.has_success and point.ends_at_success for point in points):
        raise Undrawable("a run of this problem does not end at success, so that steps do not tell when")
    last = int(max(results.num_steps, runs["steps"].max()))
    curves = success_curves(
        results, points, last, lambda table: table["steps"][table["success"].astype(bool)]
    )
    return Drawing(
        figure=draw_curves(points, curves, "runs that have succeeded (%)", is_share=True),
        title="Success by step",
        caption=f"Share of runs that have succeeded by each step, with pointwise 95% Wilson bands.{note}",
        alt=f"Line chart of the share of successful runs by step. At the last step: {ends(points, curves)}.",
    )
