"""Settings of how exploration changes over a learning run."""

from typing import ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component


class _Schedule(Component, frozen=True):
    role: ClassVar[str] = "schedule"


class Constant(_Schedule, frozen=True):
    """The same exploration in every episode."""

    target: ClassVar[str] = "bojax.learning.schedules:Constant"

    kind: Literal["constant"] = "constant"


class Decay(_Schedule, frozen=True):
    """Exploration times 1 / (1 + c t), t the number of episodes before (thesis, p. 121)."""

    target: ClassVar[str] = "bojax.learning.schedules:Decay"

    kind: Literal["decay"] = "decay"
    rate: float = Field(default=0.1, ge=0, description="c, per episode")


class Budget(_Schedule, frozen=True):
    """Exploration for some episodes, none after them; or again later (thesis, p. 119)."""

    target: ClassVar[str] = "bojax.learning.schedules:Budget"

    kind: Literal["budget"] = "budget"
    episodes: int = Field(default=30, ge=0, description="episodes with exploration")
    resume_after: int | None = Field(
        default=None, ge=1, description="episodes without it, before it goes on for good; null: never"
    )
    learns_without: bool = Field(default=False, description="whether learning goes on without exploration")


class UntilTarget(_Schedule, frozen=True):
    """Exploration until the test episodes reach their target (thesis, p. 123)."""

    target: ClassVar[str] = "bojax.learning.schedules:UntilTarget"

    kind: Literal["until-target"] = "until-target"
    learns_after: bool = Field(default=False, description="whether learning goes on after that")


class Exploit(_Schedule, frozen=True):
    """Neither exploration nor learning: an evaluation of what a learner knows."""

    target: ClassVar[str] = "bojax.learning.schedules:Exploit"

    kind: Literal["exploit"] = "exploit"
