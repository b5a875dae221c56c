"""Settings of the environments of simulated robots."""

from typing import Annotated, ClassVar, Literal

import pydantic
from pydantic import Field

from bojax.envs.settings import ClassicReward, ControlTask, MaxSteps, classic_reward
from bojax.robots.settings import MJX, PhysicsEngine


class Robot(ControlTask, frozen=True):
    """An environment of a robot that MJX simulates."""

    physics: PhysicsEngine = MJX()
    substeps: int = Field(default=1, ge=1, description="simulation steps per action")


class Hopper(Robot, frozen=True):
    """Jump with a leg of three segments (thesis, p. 107; Gym's Hopper)."""

    target: ClassVar[str] = "bojax.envs.robots.hopper:Hopper"

    kind: Literal["hopper"] = "hopper"
    goal_height: float = Field(default=1.3, gt=1.26, description="height of the torso to exceed, m")
    failure_angle: float = Field(default=0.2, gt=0, description="largest |angle| of the torso, rad")
    failure_height: float = Field(
        default=0.0, ge=0, lt=1.24, description="smallest height of the torso, m; 0.7 in the author's code"
    )
    classic_reward: ClassicReward = classic_reward(-1000)
    substeps: int = Field(default=4, ge=1, description="simulation steps of 2 ms per action")


class Reacher(Robot, frozen=True):
    """Bring the fingertip of an arm of two links to a target (thesis, p. 107; Gym's Reacher)."""

    target: ClassVar[str] = "bojax.envs.robots.reacher:Reacher"

    kind: Literal["reacher"] = "reacher"
    goal_distance: float = Field(
        default=0.015, gt=0, description="distance to the target below which the goal is reached, m"
    )
    target_radius: float = Field(
        default=0.2,
        gt=0,
        le=0.21,
        description="largest distance of the target from the shoulder, m; the arm reaches 0.21",
    )
    second_action: Literal["free", "fixed"] = Field(
        default="free",
        description="whether the learner chooses the second action, or it is always 1 (an error in the "
        "author's code)",
    )
    substeps: int = Field(default=2, ge=1, description="simulation steps of 10 ms per action")


class Jaco(Robot, frozen=True):
    """Bring the fingertips of a damaged arm to a target (thesis, Section 5.7.3)."""

    target: ClassVar[str] = "bojax.envs.robots.jaco:Jaco"

    kind: Literal["jaco"] = "jaco"
    joints: tuple[Annotated[int, Field(ge=1, le=6)], ...] = Field(
        default=(1, 2),
        strict=False,
        min_length=1,
        max_length=6,
        description="movable joints, from 1 at the base to 6 at the hand; the others are fixed",
    )
    targets: Literal["per-run", "per-episode"] = Field(
        default="per-run",
        description="one target for each run, which is not observed; or one for each episode, which is "
        "observed",
    )
    goal_distance: float = Field(
        default=0.1, gt=0, description="distance to the target below which the goal is reached, m"
    )
    substeps: int = Field(default=10, ge=1, description="simulation steps of 4 ms per action")
    max_steps: MaxSteps = 50

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> "Jaco":
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: duplicate entry")
        return self
