"""What the thesis claims, and the test that decides whether our runs agree."""

from collections.abc import Sequence
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


def _distinct(names: Sequence[str], where: str) -> None:
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: a name stands there twice")


_Tier = Annotated[
    Annotated[str, pydantic.Tag("name")]
    | Annotated[tuple[str, ...], Field(strict=False, min_length=1), pydantic.Tag("names")],
    pydantic.Discriminator(lambda value: "names" if isinstance(value, list | tuple) else "name"),
]
"""A name, or several that are not compared with each other."""


class Order(Test, frozen=True):
    """Whether the means of a column stand in an order, each above the next (paired by run)."""

    kind: Literal["order"] = "order"
    column: str = Field(description="a column of runs.parquet")
    greater: tuple[_Tier, ...] | None = Field(
        default=None,
        strict=False,
        min_length=2,
        description="names, the greatest first; a list of names stands for each of them",
    )
    less: tuple[_Tier, ...] | None = Field(
        default=None, strict=False, min_length=2, description="the same, the smallest first"
    )
    margin: float = Field(default=0.0, ge=0, description="by how much a name may fall short of the next")
    baseline: str | None = Field(
        default=None, description="then margin is a share of the lead that the next has over this name"
    )

    @pydantic.model_validator(mode="after")
    def _one_direction(self) -> Self:
        if (self.greater is None) == (self.less is None):
            raise ValueError("an order takes one of greater and less")
        _distinct(self._ordered, "less" if self.greater is None else "greater")
        if self.baseline is not None and not 0 < self.margin < 1:
            raise ValueError("with a baseline, margin is a share of a lead: between 0 and 1")
        return self

    @property
    def _ordered(self) -> tuple[str, ...]:
        tiers = self.greater or self.less or ()
        return tuple(name for tier in tiers for name in ((tier,) if isinstance(tier, str) else tier))

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return self._ordered if self.baseline is None else (*self._ordered, self.baseline)


class Ratio(Test, frozen=True):
    """Whether the ratio of two means of a column is the expected one, up to a factor (paired by run)."""

    kind: Literal["ratio"] = "ratio"
    label: str = Field(description="whose mean is divided")
    to: str = Field(description="whose mean it is divided by")
    column: str = Field(description="a column of runs.parquet with positive means")
    expected: float = Field(gt=0, description="the ratio claimed")
    tolerance: float = Field(
        gt=0, description="the ratio may be off by a factor of 1 + tolerance, either way"
    )

    @pydantic.model_validator(mode="after")
    def _two_names(self) -> Self:
        _distinct(self.names, "to")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return (self.label, self.to)


class Similar(Test, frozen=True):
    """Whether the means of a column of steps.parquet are the same at a step, up to a margin."""

    kind: Literal["similar"] = "similar"
    labels: tuple[str, ...] = Field(strict=False, min_length=2, description="whose runs")
    column: str = Field(description="a column of steps.parquet")
    step: int = Field(ge=1, description="where the means are compared")
    margin: float = Field(gt=0, description="most that two means may differ")
    spread_at: int | None = Field(
        default=None,
        ge=1,
        description="then margin is a share of the distance between the extreme means at this step",
    )

    @pydantic.model_validator(mode="after")
    def _several_names(self) -> Self:
        _distinct(self.labels, "labels")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """See the base."""
        return self.labels


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
