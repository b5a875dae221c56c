"""Settings of the physics engine that steps robots."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class PhysicsSettings(Component, frozen=True):
    """An engine of physics."""

    role: ClassVar[str] = "physics"
    plural: ClassVar[str] = "engines of physics"


class MJX(PhysicsSettings, frozen=True):
    """MuJoCo on the accelerator, in 32-bit numbers; what is null is as the robot's model has it."""

    target: ClassVar[str] = "bojax.robots.simulator:Physics"

    kind: Literal["mjx"] = "mjx"
    max_speed: float = Field(
        default=1000.0, gt=0, description="velocity beyond which a run has diverged, m/s or rad/s"
    )
    iterations: int | None = Field(default=None, ge=1, description="most iterations of the contact solver")
    ls_iterations: int | None = Field(default=None, ge=1, description="most iterations of its line search")
    integrator: Literal["euler", "rk4", "implicitfast"] | None = Field(
        default=None, description="how time goes on"
    )
    impl: Literal["jax", "warp"] = Field(default="jax", description="which implementation of MJX")
