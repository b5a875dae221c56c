"""What a user should know of a planned survey, beside its numbers."""

from collections.abc import Iterator

from bojax.surveys.lawnmower import MOST_LINES
from bojax.surveys.model import FieldModel
from bojax.surveys.planning import Demand, Survey
from bojax.surveys.team import keep_separation

LITTLE = 0.5
"""Share of the budget below which a survey that cannot use more is named."""


def remarks(survey: Survey, demand: Demand, model: FieldModel, prior: str | None) -> Iterator[str]:
    """Sentences about what a survey does not survey, use or keep; `prior` is the file of an earlier one."""
    if survey.share < 1.0 - 1e-6:
        has_ends = demand.start is not None or demand.end is not None
        part = "the part with the given points" if has_ends else "the largest part"
        share = min(100 * survey.share, 99.9)
        yield f"The area is not connected: {part}, {share:.3g}% of it, is surveyed."
    yield from model.notes
    if demand.goal.needs_values and survey.weights.min() == survey.weights.max():
        reason = "without --prior" if prior is None else f"in {prior}"
        yield f"All places count alike: {reason}, nothing tells them apart for this goal."
    if not keep_separation(survey.chosen.routes, demand.separation):
        yield f"No lawnmowers keep a separation of {demand.separation:g} m."
    longest = max(each.length for each in survey.candidates)
    if demand.budget is not None and longest < LITTLE * demand.budget:
        if demand.turning_radius:
            reason = f"no longer route that was tried has turns of {demand.turning_radius:g} m in the area"
        elif demand.spacing is not None:
            reason = f"lines are not closer than --spacing, {demand.spacing:g} m"
        else:
            reason = f"more than {MOST_LINES:,} lines are not tried"
        used = f"{survey.chosen.length:.4g} m ({100 * survey.chosen.length / demand.budget:.2g}%)"
        yield f"Only {used} of the budget of {demand.budget:.6g} m are used: {reason}."
    if left_out := survey.chosen.left_out:
        yield (
            f"The proposed lawnmower leaves out {100 * left_out:.2g}% of its waypoints, since they leave too "
            f"little room for turns of {demand.turning_radius:g} m."
        )
    if survey.chosen.length < survey.sampling * (1.0 - 1e-9):
        yield (
            f"Nothing is measured: the proposed route is shorter than {survey.sampling:.4g} m, the distance "
            "between two measurements (--sampling)."
        )
    if demand.robots == 1 and demand.separation > 0.0:
        yield "--separation: one robot does not use it."
    if demand.budget is not None and demand.spacing is not None:
        yield "--spacing: with a budget, it is only the least distance between the lines of lawnmowers."
    if demand.robots > 1:
        yield "simulation-N.yaml has robot N alone, without what others measure."
