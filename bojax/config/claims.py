"""What the thesis claims, and the test that decides whether our runs agree."""

from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field

from bojax.config.component import Registered, Schema, Slot


class Test(Registered, frozen=True):
    """A statistical test; what computes it stands in `bojax.report.claims` under the same kind."""

    role: ClassVar[str] = "test"

    by: Literal["label", "variant"] = Field(
        default="label",
        description="what names mean; of several variants of one label, the best mean stands for it",
    )

    @property
    def names(self) -> tuple[str, ...]:
        """The labels or variants that the test speaks of."""
        raise NotImplementedError


class Order(Test, frozen=True):
    """Whether the means of a column stand in an order, each above the next (paired by run)."""

    kind: Literal["order"] = "order"
    column: str = Field(description="a column of runs.parquet")
    greater: tuple[str, ...] = Field(strict=False, min_length=2, description="names, the greatest first")

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Self:
        if len(set(self.greater)) < len(self.greater):
            raise ValueError("greater: a name stands there twice")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return self.greater


class Share(Test, frozen=True):
    """Whether the share of runs with a property is above, or below, a threshold (Wilson interval)."""

    kind: Literal["share"] = "share"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of runs.parquet, counted where it is true or not zero")
    within: int | None = Field(default=None, ge=1, description="count only runs of at most so many steps")
    above: float | None = Field(default=None, ge=0, le=1, description="threshold that the share exceeds")
    below: float | None = Field(default=None, ge=0, le=1, description="threshold that the share stays under")

    @pydantic.model_validator(mode="after")
    def _one_threshold(self) -> Self:
        if (self.above is None) == (self.below is None):
            raise ValueError("a share takes one of above and below")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return (self.label,)


class Trend(Test, frozen=True):
    """Whether the mean of a column of steps.parquet rises, or falls, between two steps."""

    model_config = pydantic.ConfigDict(serialize_by_alias=True)

    kind: Literal["trend"] = "trend"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of steps.parquet")
    first: int = Field(alias="from", ge=1, description="step of departure")
    last: int = Field(alias="to", ge=2, description="step of arrival")
    direction: Literal["rises", "falls"] = Field(description="what the mean does in between")

    @pydantic.model_validator(mode="after")
    def _forward(self) -> Self:
        if self.first >= self.last:
            raise ValueError(f"to must lie after from, which is {self.first}")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return (self.label,)


class Claim(Schema, frozen=True):
    """One statement of the thesis."""

    id: str = Field(min_length=1, description="unique in the sweep")
    source: str = Field(description="figure or table, and page")
    claim: str = Field(description="the statement in words")
    thesis: str | float | None = Field(
        default=None, union_mode="left_to_right", description="the thesis's value, a number or text"
    )
    test: Annotated[Test, Slot("test")] = Field(description="the test that decides")
