"""The figures of a report: one function in one file each, and one line here."""

from collections.abc import Mapping

from bojax.report.figures import (
    accumulated_reward,
    beliefs,
    error_map,
    errors,
    learning_curves,
    paths,
    returns,
    settings_compared,
    solved,
    steps_to_goal,
    success,
    surfaces,
    sweep_curve,
    trajectories,
    value_maps,
)
from bojax.report.figures.base import Draw

FIGURES: Mapping[str, Draw] = {
    "accumulated-reward": accumulated_reward.draw,
    "success": success.draw,
    "learning-curves": learning_curves.draw,
    "success-episodes": success.draw_episodes,
    "solved-episodes": solved.draw,
    "steps-to-goal": steps_to_goal.draw,
    "value-maps": value_maps.draw,
    "growth": sweep_curve.draw_growth,
    "sweep-curve": sweep_curve.draw,
    "returns": returns.draw,
    "errors": errors.draw,
    "paths": paths.draw,
    "beliefs": beliefs.draw,
    "surfaces": surfaces.draw,
    "error-map": error_map.draw,
    "trajectories": trajectories.draw,
    "settings": settings_compared.draw,
}
"""By the name that a sweep's `report.figures` uses, which is also the name of the file."""
