"""The figures of a report: one function in one file each, and one line here."""

from collections.abc import Mapping

from bojax.report.figures import (
    accumulated_reward,
    beliefs,
    errors,
    paths,
    returns,
    settings,
    success,
    trajectories,
)
from bojax.report.figures.base import Draw

FIGURES: Mapping[str, Draw] = {
    "accumulated-reward": accumulated_reward.draw,
    "success": success.draw,
    "returns": returns.draw,
    "errors": errors.draw,
    "paths": paths.draw,
    "beliefs": beliefs.draw,
    "trajectories": trajectories.draw,
    "settings": settings.draw,
}
"""By the name that a sweep's `report.figures` uses, which is also the name of the file."""
