"""Settings of the learners with function approximation."""

from typing import ClassVar

from pydantic import Field

from bojax.config.component import Component


class LearnerSettings(Component, frozen=True):
    """What every learner can be told."""

    role: ClassVar[str] = "learner"

    discount: float = Field(default=0.99, gt=0, le=1, description="discount of rewards per step (gamma)")
