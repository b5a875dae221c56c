"""Settings of the environments with continuous states."""

from typing import ClassVar

from pydantic import Field

from bojax.config.component import Component


class Environment(Component, frozen=True):
    """What every environment can be told."""

    role: ClassVar[str] = "env"

    max_steps: int = Field(default=500, ge=1, description="steps after which an episode is cut off")
