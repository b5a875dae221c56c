"""Settings of the families of trajectories."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class MotionSettings(Component, frozen=True):
    """A family of trajectories."""

    role: ClassVar[str] = "motions"
    plural: ClassVar[str] = "families of trajectories"


class DiscreteMotions(MotionSettings, frozen=True):
    """A finite set of trajectories."""


class ContinuousMotions(MotionSettings, frozen=True):
    """A family of trajectories with continuous parameters."""


class Splines(DiscreteMotions, frozen=True):
    """A discrete set of cubic splines of equal arc length (thesis, Section 3.5, Fig. 4.2a)."""

    target: ClassVar[str] = "bojax.motions.splines:SplineSet"
    kind: Literal["splines"] = "splines"
    actions: Literal[5, 9, 17] = Field(default=5, description="number of splines in the set")
    length: float = Field(default=1.0, gt=0, description="arc length, m")
    num_samples: int = Field(default=10, ge=2, description="poses per trajectory")


class CubicCurves(ContinuousMotions, frozen=True):
    """Continuous cubic curves, parametrised by the bearing and the heading of their end."""

    target: ClassVar[str] = "bojax.motions.splines:CubicCurves"
    kind: Literal["cubic"] = "cubic"
    length: float = Field(default=1.0, gt=0, description="arc length, m")
    bearing: float = Field(default=0.8, gt=0, description="largest bearing of the end from the start, rad")
    heading: float = Field(default=1.5, gt=0, description="largest turn of the end off a circular arc, rad")
    num_samples: int = Field(default=10, ge=2, description="poses per trajectory")


class KernelTrajectories(ContinuousMotions, frozen=True):
    """Trajectories by kernel Bayes' rule from anchor points (thesis, Sections 4.5-4.6)."""

    target: ClassVar[str] = "bojax.motions.kernel_trajectories:KernelTrajectories"
    kind: Literal["kernel"] = "kernel"
    num_segments: int = Field(
        default=3, ge=1, description="number of segments, each with one parameter, its turning angle"
    )
    length: float = Field(default=1.0, gt=0, description="arc length, m")
    first_angle: float = Field(default=1.2, ge=0, description="largest first angle from the heading, rad")
    turn_angle: float = Field(default=1.25, ge=0, description="largest angle between two segments, rad")
    space_lengthscale: float = Field(
        default=0.5, gt=0, description="lengthscale of the kernel on positions, in units of the length"
    )
    time_lengthscale: float = Field(
        default=1.0, gt=0, description="lengthscale of the kernel on time; the duration of a trajectory is 1"
    )
    epsilon: float = Field(default=0.1, gt=0, description="regulariser of kernel Bayes' rule (4.9)")
    delta: float = Field(default=1e-5, gt=0, description="regulariser of kernel Bayes' rule (4.8)")
    start: Literal["pose", "relaxed"] = Field(
        default="pose", description="whether a path starts along the robot's heading, or in a free direction"
    )
    num_samples: int = Field(default=10, ge=2, description="poses per trajectory")
