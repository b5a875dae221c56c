"""Settings of the environments with continuous states."""

import json
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic
from pydantic import Field

from bojax.config.component import Component, Slot
from bojax.config.physics import MJX


class Environment(Component, frozen=True):
    """What every environment can be told."""

    role: ClassVar[str] = "env"

    max_steps: int = Field(default=500, ge=1, description="steps after which an episode is cut off")


class ControlTask(Environment, frozen=True):
    """What the domains of Section 5.7.2 can be told."""

    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only", description="1 at the goal, -1 at a failure, 0 else; or what Gym pays"
    )


class SinglePendulum(ControlTask, frozen=True):
    """Swing a pendulum up with a weak motor (thesis, p. 107; Gym's Pendulum)."""

    target: ClassVar[str] = "bojax.envs.single_pendulum:SinglePendulum"

    kind: Literal["single-pendulum"] = "single-pendulum"
    goal_angle: float = Field(default=0.05, gt=0, description="largest angle from upright at the goal, rad")
    classic_ends_at_goal: bool = Field(
        default=True,
        description="whether the goal ends an episode with the classic reward; in Gym it does not",
    )
    gravity: float = Field(default=10.0, ge=0, description="gravity, m/s^2")
    mass: float = Field(default=1.0, gt=0, description="mass of the rod, kg")
    length: float = Field(default=1.0, gt=0, description="length of the rod, m")
    max_torque: float = Field(default=2.0, gt=0, description="bound on the torque, N m")
    max_speed: float = Field(default=8.0, gt=0, description="bound on the angular velocity, rad/s")
    time_step: float = Field(default=0.05, gt=0, description="time step, s")


class MountainCar(ControlTask, frozen=True):
    """Drive a weak car up a hill by building momentum (thesis, p. 106; Gym's MountainCar)."""

    target: ClassVar[str] = "bojax.envs.mountain_car:MountainCar"

    kind: Literal["mountain-car"] = "mountain-car"
    goal_position: float = Field(
        default=0.5, gt=-1.2, le=0.6, description="least position at the goal; 0.42 in Fig. 5.7"
    )
    actions: Literal["continuous", "thresholded"] = Field(
        default="continuous", description="whether an action is a force, or picks left, coast or right"
    )
    threshold: float = Field(
        default=0.33, ge=0, le=1, description="least |action| that drives, where actions are thresholded"
    )
    power: float = Field(default=0.001, gt=0, description="velocity gained by an action of 1, per step")
    gravity: float = Field(
        default=0.0025, ge=0, description="velocity gained on the steepest slope, per step"
    )


class DoublePendulum(ControlTask, frozen=True):
    """Swing a two-link pendulum up with one weak motor (thesis, p. 107; Gym's Acrobot)."""

    target: ClassVar[str] = "bojax.envs.double_pendulum:DoublePendulum"

    kind: Literal["double-pendulum"] = "double-pendulum"
    actuated: Literal["base", "elbow"] = Field(
        default="base", description="the driven joint; in Gym it is the elbow"
    )
    goal: Literal["distance", "height"] = Field(
        default="distance", description="whether the goal is a distance to the highest point, or a height"
    )
    goal_distance: float = Field(
        default=1.0, gt=0, description="largest distance to the highest point, or largest depth below it, m"
    )
    actions: Literal["continuous", "sign"] = Field(
        default="continuous", description="whether the torque is the action, or the largest with its sign"
    )
    max_torque: float = Field(default=1.0, gt=0, description="bound on the torque, N m")
    time_step: float = Field(default=0.2, gt=0, description="time step, s")


class CartpoleSwingUp(ControlTask, frozen=True):
    """Swing a pole up by moving its cart (thesis, p. 107; Gym's CartPole, started hanging)."""

    target: ClassVar[str] = "bojax.envs.cartpole_swing_up:CartpoleSwingUp"

    kind: Literal["cartpole-swing-up"] = "cartpole-swing-up"
    goal_cosine: float = Field(
        default=0.8, ge=-1, lt=1, description="bound on the cosine of the angle at the goal"
    )
    limit: float = Field(default=2.4, gt=0, description="largest |position| on the track, m")
    actions: Literal["continuous", "sign"] = Field(
        default="continuous", description="whether the force is the action, or the largest with its sign"
    )
    max_force: float = Field(default=10.0, gt=0, description="bound on the force, N")
    time_step: float = Field(default=0.02, gt=0, description="time step, s")


class Robot(ControlTask, frozen=True):
    """What the robots that MJX steps can be told."""

    physics: Annotated[Component, Slot("physics")] = Field(default=MJX(), description="how MJX computes")
    substeps: int = Field(default=1, ge=1, description="steps of the physics for one action")


class Hopper(Robot, frozen=True):
    """Jump with a leg of three segments (thesis, p. 107; Gym's Hopper)."""

    target: ClassVar[str] = "bojax.envs.robots.hopper:Hopper"

    kind: Literal["hopper"] = "hopper"
    goal_height: float = Field(default=1.3, gt=1.26, description="height of the torso to be exceeded, m")
    failure_angle: float = Field(default=0.2, gt=0, description="largest |angle| of the torso, rad")
    failure_height: float = Field(
        default=0.0, ge=0, lt=1.24, description="least height of the torso, m; 0.7 in the author's code"
    )
    substeps: int = Field(default=4, ge=1, description="steps of the physics, of 2 ms, for one action")


class Reacher(Robot, frozen=True):
    """Bring the tip of an arm of two links to a target (thesis, p. 107; Gym's Reacher)."""

    target: ClassVar[str] = "bojax.envs.robots.reacher:Reacher"

    kind: Literal["reacher"] = "reacher"
    goal_distance: float = Field(default=0.015, gt=0, description="distance to the target to be undercut, m")
    target_radius: float = Field(
        default=0.2, gt=0, le=0.21, description="largest distance of the target from the shoulder, m"
    )
    substeps: int = Field(default=2, ge=1, description="steps of the physics, of 10 ms, for one action")


class Jaco(Robot, frozen=True):
    """Bring the finger tips of a damaged arm to a target (thesis, Section 5.7.3)."""

    target: ClassVar[str] = "bojax.envs.robots.jaco:Jaco"

    kind: Literal["jaco"] = "jaco"
    joints: tuple[Annotated[int, Field(ge=1, le=6)], ...] = Field(
        default=(1, 2),
        strict=False,
        min_length=1,
        max_length=6,
        description="joints that move, from 1 at the base to 6 at the hand; the others are stuck",
    )
    targets: Literal["per-run", "per-episode"] = Field(
        default="per-run", description="one target for a run, not observed; or one for an episode, observed"
    )
    goal_distance: float = Field(default=0.1, gt=0, description="distance to the target to be undercut, m")
    substeps: int = Field(default=10, ge=1, description="steps of the physics, of 4 ms, for one action")
    max_steps: int = Field(default=50, ge=1, description="steps after which an episode is cut off")

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Self:
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: one stands there twice")
        return self


class LunarLander(ControlTask, frozen=True):
    """Land on a pad between hills (thesis, p. 107; Gym's LunarLander, continuous)."""

    target: ClassVar[str] = "bojax.envs.robots.lunar_lander:LunarLander"

    kind: Literal["lunar-lander"] = "lunar-lander"
    goal_distance: float = Field(
        default=0.05, gt=0, description="distance to the pad's centre at the goal, in units of observations"
    )
    gravity: float = Field(default=10.0, ge=0, description="gravity, m/s^2")
    main_power: float = Field(
        default=13.0, ge=0, description="impulse of the main engine, N s, for each metre to the hull's origin"
    )
    side_power: float = Field(default=0.6, ge=0, description="the same of the side engines")
    dispersion: float = Field(
        default=1.0, ge=0, description="scale of the noise of the engines' impulses; 1 in Gym"
    )
    max_push: float = Field(
        default=1000.0, ge=0, description="bound on the force of the first step, in either direction, N"
    )
    max_speed: float = Field(
        default=1000.0, gt=0, description="speed, m/s or rad/s, beyond which a simulation has diverged"
    )


Bounds = float | Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
"""One number, or one for each component."""


class Brax(Environment, frozen=True):
    """An environment of Brax, compiled (extra `brax`)."""

    target: ClassVar[str] = "bojax.envs.brax:BraxEnv"

    kind: Literal["brax"] = "brax"
    name: str = Field(min_length=1, description="its name in Brax, such as reacher")
    backend: Literal["mjx", "generalized", "positional", "spring"] = Field(
        default="mjx", description="the physics"
    )
    low: Bounds = Field(default=-10.0, description="lower bound of observations, one number or one for each")
    high: Bounds = Field(default=10.0, description="upper bound of observations")
    success_reward: float | None = Field(
        default=None, description="least reward of a step that is a success; null: there is none"
    )


class Gymnasium(Component, frozen=True):
    """An environment of Gymnasium, stepped on the host while the learner is compiled (extra `gym`)."""

    role: ClassVar[str] = "env"
    target: ClassVar[str] = "bojax.envs.gymnasium:HostEnv"

    kind: Literal["gymnasium"] = "gymnasium"
    id: str = Field(
        min_length=1, description="its id, such as MountainCar-v0; module:Name-v0 imports the module first"
    )
    kwargs: dict[str, Any] = Field(default={}, description="arguments of its constructor")
    low: Bounds | None = Field(
        default=None,
        description="lower bound of observations; null: the declared one, which has to be finite",
    )
    high: Bounds | None = Field(
        default=None, description="upper bound of observations; null: the declared one"
    )
    max_steps: int | None = Field(
        default=None, ge=1, description="steps after which an episode is cut off; null: as registered"
    )
    success: Literal["never", "terminated", "reward"] = Field(
        default="never",
        description="a success is: nothing; an absorbing state; a step with success_reward at least",
    )
    success_reward: float = Field(
        default=1.0, description="least reward of a success, where success is reward"
    )

    @pydantic.model_validator(mode="after")
    def _json(self) -> Self:
        try:
            json.dumps(self.kwargs)
        except TypeError as error:
            raise ValueError(f"kwargs: {error}") from error
        return self
