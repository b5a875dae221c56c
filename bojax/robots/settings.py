"""Settings of the physics engine that simulates robots."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component, Slot


class PhysicsSettings(Component, frozen=True):
    """A physics engine."""

    role: ClassVar[str] = "physics"
    plural: ClassVar[str] = "physics engines"


class MJX(PhysicsSettings, frozen=True):
    """MuJoCo, with a state of 32 bits; null keeps the value of the robot's model."""

    target: ClassVar[str] = "bojax.robots.simulator:Physics"

    kind: Literal["mjx"] = "mjx"
    max_speed: float = Field(
        default=1000.0, gt=0, description="generalised velocity above which a run has diverged, m/s or rad/s"
    )
    iterations: int | None = Field(
        default=None,
        ge=1,
        description="largest number of iterations of the solver of contacts and limits; null for the model's",
    )
    ls_iterations: int | None = Field(
        default=None,
        ge=1,
        description="largest number of iterations of the solver's line search; null for the model's. That of "
        "jax and pallas is exact and needs none, except with elliptic friction cones or the solver CG",
    )
    integrator: Literal["euler", "rk4", "implicitfast"] | None = Field(
        default=None, description="integration scheme"
    )
    impl: Literal["auto", "jax", "pallas", "c"] = Field(
        default="auto",
        description="implementation of the steps: MJX in JAX as a program of XLA, MJX as one kernel, "
        "or C MuJoCo; auto is c on a CPU, for models with contacts or closed loops, pallas on an NVIDIA "
        "GPU, for models that can be a kernel, and otherwise jax, or c for models that MJX refuses",
    )


PhysicsEngine = Annotated[Component, Slot("physics"), Field(description="settings of the simulation")]
"""The setting `physics` of a part that contains a simulated robot."""
