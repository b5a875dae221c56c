"""What the thesis claims, and the test that decides whether our runs agree."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.config.component import Registered, Schema, Slot


class Test(Registered, frozen=True):
    """A statistical test; what computes it stands in `bojax.report.claims` under the same kind."""

    role: ClassVar[str] = "test"
    model_config = pydantic.ConfigDict(serialize_by_alias=True)

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


class Window(Schema, frozen=True):
    """Episodes over which a column of episodes.parquet is averaged within a run."""

    model_config = pydantic.ConfigDict(serialize_by_alias=True)

    first: int = Field(alias="from", ge=1, description="first episode, from 1")
    last: int = Field(alias="to", ge=1, description="last episode, that one included")
    phase: Literal["train", "test"] = Field(
        default="train", description="training episodes, or the tests that follow each of them"
    )

    @pydantic.model_validator(mode="after")
    def _forward(self) -> Self:
        if self.first > self.last:
            raise ValueError(f"to must not lie before from, which is {self.first}")
        return self


class Measured(Test, frozen=True):
    """A test of one number per run: of runs.parquet, or a mean over episodes."""

    column: str = Field(description="a column of runs.parquet, or with a window of episodes.parquet")
    window: Window | None = Field(
        default=None, description="then a run's value is the mean of the column over these episodes"
    )
    since: Window | None = Field(
        default=None, description="then less its mean over these episodes: by how much it has changed"
    )

    @pydantic.model_validator(mode="after")
    def _since_of_a_window(self) -> Self:
        if self.since is not None and self.window is None:
            raise ValueError("since goes with a window")
        return self


class Order(Measured, frozen=True):
    """Whether the means of a column stand in an order, each above the next (paired by run)."""

    kind: Literal["order"] = "order"
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
    @override
    def names(self) -> tuple[str, ...]:
        return self._ordered if self.baseline is None else (*self._ordered, self.baseline)


class Ratio(Measured, frozen=True):
    """Whether the ratio of two means of a column is the expected one, up to a factor (paired by run)."""

    kind: Literal["ratio"] = "ratio"
    label: str = Field(description="whose mean is divided")
    to: str = Field(description="whose mean it is divided by")
    expected: float = Field(gt=0, description="the ratio claimed")
    tolerance: float = Field(
        gt=0, description="the ratio may be off by a factor of 1 + tolerance, either way"
    )

    @pydantic.model_validator(mode="after")
    def _two_names(self) -> Self:
        _distinct(self.names, "to")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return (self.label, self.to)


_Place = Annotated[
    Annotated[Annotated[int, Field(ge=1)], pydantic.Tag("step")] | Annotated[Window, pydantic.Tag("window")],
    pydantic.Discriminator(lambda value: "window" if isinstance(value, Mapping | Window) else "step"),
]
"""A step of an episode, or episodes."""


class Similar(Measured, frozen=True):
    """Whether means are the same, up to a margin: of runs, over episodes, or at a step of steps.parquet."""

    kind: Literal["similar"] = "similar"
    labels: tuple[str, ...] = Field(strict=False, min_length=2, description="whose runs")
    step: int | None = Field(
        default=None, ge=1, description="then means of a column of steps.parquet are compared at this step"
    )
    margin: float = Field(gt=0, description="most that two means may differ")
    spread_at: _Place | None = Field(
        default=None,
        description="then margin is a share of the distance between the extreme means at this step, "
        "or over these episodes",
    )

    @pydantic.model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.step is not None and self.window is not None:
            raise ValueError("similar takes one of step and window")
        place = self.step or self.window
        if self.spread_at is not None and type(self.spread_at) is not type(place):
            raise ValueError("spread_at is a step where step is given, and episodes where window is")
        return self

    @pydantic.model_validator(mode="after")
    def _several_names(self) -> Self:
        _distinct(self.labels, "labels")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return self.labels


class Share(Test, frozen=True):
    """Whether the share of runs with a property is above, or below, a threshold (Wilson interval)."""

    kind: Literal["share"] = "share"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of runs.parquet, counted where it is true or not zero")
    window: Window | None = Field(
        default=None, description="then of episodes.parquet, counted where it is so in one of these episodes"
    )
    within: int | None = Field(default=None, ge=1, description="count only runs of at most so many steps")
    above: float | None = Field(default=None, ge=0, le=1, description="threshold that the share exceeds")
    below: float | None = Field(default=None, ge=0, le=1, description="threshold that the share stays under")

    @pydantic.model_validator(mode="after")
    def _one_threshold(self) -> Self:
        if (self.above is None) == (self.below is None):
            raise ValueError("a share takes one of above and below")
        if self.within is not None and self.window is not None:
            raise ValueError("a share takes one of within and window")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return (self.label,)


class Mean(Measured, frozen=True):
    """Whether the mean of a column is above, or below, a threshold."""

    kind: Literal["mean"] = "mean"
    label: str = Field(description="whose runs")
    above: float | None = Field(default=None, description="threshold that the mean exceeds")
    below: float | None = Field(default=None, description="threshold that the mean stays under")

    @pydantic.model_validator(mode="after")
    def _a_threshold(self) -> Self:
        if self.above is None and self.below is None:
            raise ValueError("a mean takes above, below, or both")
        if self.above is not None and self.below is not None and self.above >= self.below:
            raise ValueError(f"below must exceed above, which is {self.above:g}")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return (self.label,)


class Trend(Test, frozen=True):
    """Whether the mean of a column rises, or falls: between two steps, or between two windows of episodes."""

    kind: Literal["trend"] = "trend"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of steps.parquet, or of episodes.parquet")
    first: _Place = Field(alias="from", description="step, or episodes, of departure")
    last: _Place = Field(alias="to", description="step, or episodes, of arrival")
    direction: Literal["rises", "falls"] = Field(description="what the mean does in between")

    @pydantic.model_validator(mode="after")
    def _forward(self) -> Self:
        if type(self.first) is not type(self.last):
            raise ValueError("from and to are both steps, or both episodes")
        if isinstance(self.first, int) and isinstance(self.last, int) and self.first >= self.last:
            raise ValueError(f"to must lie after from, which is {self.first}")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return (self.label,)


class Agrees(Test, frozen=True):
    """Whether our mean, or our share of runs, is that of a table: the interval of the difference holds 0."""

    kind: Literal["agrees"] = "agrees"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of runs.parquet; of a share, counted where it is true")
    mean: float | None = Field(default=None, description="the mean printed")
    sd: float | None = Field(default=None, ge=0, description="the standard deviation printed with it")
    share: float | None = Field(default=None, ge=0, le=1, description="or the share printed")
    runs: int = Field(ge=2, description="runs that the printed number rests on")
    tolerance: float | None = Field(
        default=None,
        gt=0,
        description="the interval has to lie within so much of 0; by default the printed standard "
        "deviation, and 0.25 for a share",
    )
    missing: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="largest share of our runs without a number (the goal never reached), which are left out",
    )

    @pydantic.model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.mean is None) == (self.share is None):
            raise ValueError("agrees takes one of mean and share")
        if (self.mean is None) != (self.sd is None):
            raise ValueError("mean and sd go together")
        if self.sd == 0 and self.tolerance is None:
            raise ValueError("tolerance: a number is needed where sd is 0")
        return self

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return (self.label,)


class Growth(Test, frozen=True):
    """Whether the mean of a column grows with a swept number as expected, rather than in another way."""

    kind: Literal["growth"] = "growth"
    label: str = Field(description="whose runs")
    column: str = Field(description="a column of runs.parquet with positive means")
    over: str = Field(description="the swept number, a dotted path such as env.length")
    expected: Literal["linear", "quadratic", "exponential"] = Field(
        description="a + b x, a + b x^2 or a exp(b x)"
    )
    missing: float = Field(
        default=0.05,
        ge=0,
        lt=1,
        description="largest share of the runs of a point without a number (the goal never reached), which "
        "are left out",
    )

    @property
    @override
    def names(self) -> tuple[str, ...]:
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
