"""Settings of the statistical tests of claims."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.config.claims import Test, Window


def _distinct(names: Sequence[str], where: str) -> None:
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: duplicate name")


_Tier = Annotated[
    Annotated[str, pydantic.Tag("name")]
    | Annotated[tuple[str, ...], Field(strict=False, min_length=1), pydantic.Tag("names")],
    pydantic.Discriminator(lambda value: "names" if isinstance(value, list | tuple) else "name"),
]
"""A name, or several names that are not compared with each other."""


_Place = Annotated[
    Annotated[Annotated[int, Field(ge=1)], pydantic.Tag("step")] | Annotated[Window, pydantic.Tag("window")],
    pydantic.Discriminator(lambda value: "window" if isinstance(value, Mapping | Window) else "step"),
]
"""A step, or a window of episodes."""


class Measured(Test, frozen=True):
    """A test of one number per run: of runs.parquet, at a step, or a mean over episodes."""

    column: str = Field(description="a column of runs.parquet, or of episodes.parquet if a window is given")
    window: Window | None = Field(
        default=None, description="episodes over which the column is averaged within a run"
    )
    step: int | None = Field(
        default=None, ge=1, description="step at which a column of steps.parquet is taken, in place of window"
    )
    since: _Place | None = Field(
        default=None,
        description="step or episodes whose value is subtracted, to test a change up to step or window",
    )
    statistic: Literal["mean", "sd"] = Field(
        default="mean",
        description="statistic of the episodes of a window within a run: mean, or standard deviation",
    )

    @property
    def place(self) -> int | Window | None:
        """The step or the episodes at which the column is taken; None for a column of runs.parquet."""
        return self.step if self.window is None else self.window

    @pydantic.model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.step is not None and self.window is not None:
            raise ValueError(f"{self.kind}: give either step or window")
        if self.since is not None and type(self.since) is not type(self.place):
            raise ValueError("since: needs a step if since is a step, and a window if it is a window")
        if isinstance(self.since, int) and self.step is not None and self.since >= self.step:
            raise ValueError(f"step must lie after since, which is {self.since}")
        if self.statistic == "sd" and self.window is None:
            raise ValueError("statistic: needs a window of episodes")
        return self


_Missing = Annotated[
    float,
    Field(
        ge=0,
        lt=1,
        description="largest share of the runs of a point that may lack a value (the goal was never reached) "
        "and are left out",
    ),
]


class OfOneLabel(Test, frozen=True):
    """A test of the runs of one label or variant."""

    label: str = Field(description="label or variant whose runs are tested")


class Order(Measured, frozen=True):
    """Whether the means of a column are in the given order, each above the next (paired by run)."""

    target: ClassVar[str] = "bojax.claims.order:order"

    kind: Literal["order"] = "order"
    greater: tuple[_Tier, ...] | None = Field(
        default=None,
        strict=False,
        min_length=2,
        description="names in descending order of their means; names in a nested list are not "
        "compared with each other",
    )
    less: tuple[_Tier, ...] | None = Field(
        default=None, strict=False, min_length=2, description="names in ascending order of their means"
    )
    margin: float = Field(
        default=0.0,
        description="amount by which the mean of a name may fall short of the next; if negative, by which it "
        "has to exceed the next",
    )
    parts: int = Field(
        default=1,
        ge=1,
        description="number of equal parts of window; the order has to hold in each of them, as of curves",
    )
    baseline: str | None = Field(
        default=None,
        description="name; margin is then a share of the lead of the next mean over the mean of this name",
    )
    censored_at: float | None = Field(
        default=None,
        description="number that stands for a missing one, such as the number of episodes after which a run "
        "was stopped; a time to a goal or target beyond it counts as this number too (means are then "
        "restricted means)",
    )

    @pydantic.model_validator(mode="after")
    def _one_direction_in_whole_parts(self) -> Self:
        if (self.greater is None) == (self.less is None):
            raise ValueError("order: give either greater or less")
        _distinct(sum(self.tiers, ()), "less" if self.greater is None else "greater")
        if self.baseline is not None and not (self.margin < 1 and self.margin != 0):
            raise ValueError("margin: with a baseline it is a share of a lead, below 1 and not 0")
        if self.censored_at is not None and self.place is not None:
            raise ValueError("censored_at: needs a column of runs.parquet, without step or window")
        if self.parts > 1:
            window = self.window
            number = 0 if window is None else window.last - window.first + 1
            if number % self.parts or number < 2 * self.parts:
                raise ValueError(
                    f"parts: got {self.parts}; allowed: a number that divides the episodes of window into "
                    "parts of at least 2"
                )
            if window is not None and window.counted_from != "start":
                raise ValueError("parts: needs a window that is counted from the start")
        return self

    @property
    def tiers(self) -> tuple[tuple[str, ...], ...]:
        """The names in the claimed order; names of one tier are not compared with each other."""
        listed = self.greater or self.less or ()
        return tuple((tier,) if isinstance(tier, str) else tier for tier in listed)

    @property
    @override
    def names(self) -> tuple[str, ...]:
        ranked = sum(self.tiers, ())
        return ranked if self.baseline in (None, *ranked) else (*ranked, self.baseline)


class Ratio(Measured, frozen=True):
    """Whether the ratio of two means of a column is the expected one, up to a factor (paired by run)."""

    target: ClassVar[str] = "bojax.claims.means:ratio"

    kind: Literal["ratio"] = "ratio"
    label: str = Field(description="label or variant whose mean is the numerator")
    to: str = Field(description="label or variant whose mean is the denominator")
    expected: float = Field(gt=0, description="claimed ratio, other than 1")
    tolerance: float = Field(
        default=0.1,
        gt=0,
        description="the ratio may differ from expected by a factor of up to 1 + tolerance, but not be on "
        "the other side of 1",
    )

    @pydantic.model_validator(mode="after")
    def _two_names_apart(self) -> Self:
        _distinct(self.names, "to")
        if self.expected == 1:
            raise ValueError("expected: a ratio of 1 is tested by kind similar, with a factor")
        return self


class Similar(Measured, frozen=True):
    """Whether means differ by less than a margin or a factor: of runs, over episodes, or at a step."""

    target: ClassVar[str] = "bojax.claims.means:similar"

    kind: Literal["similar"] = "similar"
    labels: tuple[str, ...] = Field(
        strict=False, min_length=2, description="labels or variants whose means are compared"
    )
    margin: float | None = Field(default=None, gt=0, description="largest difference between two means")
    factor: float | None = Field(
        default=None, gt=1, description="largest ratio of two means, in place of margin"
    )
    spread_at: _Place | None = Field(
        default=None, description="step or episodes; margin is then a share of the range of the means there"
    )

    @pydantic.model_validator(mode="after")
    def _distinct_labels_at_one_place(self) -> Self:
        _distinct(self.labels, "labels")
        if (self.margin is None) == (self.factor is None):
            raise ValueError("similar: give either margin or factor")
        if self.spread_at is not None and self.margin is None:
            raise ValueError("spread_at: needs a margin, which is a share of the range of the means there")
        if self.spread_at is not None and type(self.spread_at) is not type(self.place):
            raise ValueError("spread_at: needs a step if step is given, and a window if window is given")
        return self


class Share(OfOneLabel, frozen=True):
    """Whether the share of runs with a property is above or below a threshold (Wilson interval)."""

    target: ClassVar[str] = "bojax.claims.means:share"

    kind: Literal["share"] = "share"
    column: str = Field(description="a column of runs.parquet; a run counts if its value is true or not zero")
    window: Window | None = Field(
        default=None,
        description="episodes; a run counts if the column of episodes.parquet is true in one of them",
    )
    within: int | None = Field(default=None, ge=1, description="largest number of steps of a run that counts")
    above: float | None = Field(default=None, ge=0, le=1, description="threshold that the share exceeds")
    below: float | None = Field(default=None, ge=0, le=1, description="threshold that the share stays under")

    @pydantic.model_validator(mode="after")
    def _one_threshold(self) -> Self:
        if (self.above is None) == (self.below is None):
            raise ValueError("share: give either above or below")
        if self.within is not None and self.window is not None:
            raise ValueError("share: give either within or window")
        return self


class Mean(Measured, OfOneLabel, frozen=True):
    """Whether the mean of a column, or each of several, is above or below a threshold, or between two."""

    target: ClassVar[str] = "bojax.claims.means:mean"

    kind: Literal["mean"] = "mean"
    above: float | None = Field(default=None, description="threshold that the mean exceeds")
    below: float | None = Field(default=None, description="threshold that the mean stays under")
    also: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="further columns whose means have to be on the same side of the only threshold, with "
        "Holm's correction over all columns",
    )

    @pydantic.model_validator(mode="after")
    def _a_threshold(self) -> Self:
        _distinct((self.column, *self.also), "also")
        if self.also and self.above is not None and self.below is not None:
            raise ValueError("also: needs a single threshold, above or below")
        if self.above is None and self.below is None:
            raise ValueError("mean: give above, below, or both")
        if self.above is not None and self.below is not None and self.above >= self.below:
            raise ValueError(f"below must exceed above, which is {self.above:g}")
        return self


class Trend(OfOneLabel, frozen=True):
    """Whether the mean of a column rises or falls between two steps, or between two windows of episodes."""

    target: ClassVar[str] = "bojax.claims.means:trend"

    kind: Literal["trend"] = "trend"
    column: str = Field(description="a column of steps.parquet, or of episodes.parquet")
    first: _Place = Field(alias="from", description="step or episodes at which the change begins")
    last: _Place = Field(alias="to", description="step or episodes at which the change ends")
    direction: Literal["rises", "falls"] = Field(description="claimed direction of the change")
    ended: Literal["kept", "left-out"] = Field(
        default="kept",
        description="between steps: whether a run that has ended keeps its last value, or is left out; then "
        "the change is to the mean of all steps after `from`, up to `to`, as few runs may last until `to`",
    )

    @pydantic.model_validator(mode="after")
    def _forward(self) -> Self:
        if self.ended == "left-out" and isinstance(self.first, Window):
            raise ValueError("ended: left-out needs two steps")
        if type(self.first) is not type(self.last):
            raise ValueError("from and to: give two steps or two windows")
        if isinstance(self.first, int) and isinstance(self.last, int) and self.first >= self.last:
            raise ValueError(f"to must lie after from, which is {self.first}")
        return self


class Agrees(OfOneLabel, frozen=True):
    """Whether our mean or share of runs agrees with a printed one: the difference may be 0."""

    target: ClassVar[str] = "bojax.claims.means:agrees"

    kind: Literal["agrees"] = "agrees"
    column: str = Field(
        description="a column of runs.parquet; for a share, a run counts if its value is true"
    )
    mean: float | None = Field(default=None, description="printed mean")
    sd: float | None = Field(default=None, ge=0, description="printed standard deviation")
    share: float | None = Field(
        default=None, ge=0, le=1, description="printed share, in place of mean and sd"
    )
    runs: int = Field(ge=2, description="number of runs behind the printed number")
    tolerance: float | None = Field(
        default=None,
        gt=0,
        description="largest absolute value in the interval of the difference; null for the printed standard "
        "deviation, or 0.25 for a share",
    )
    missing: _Missing = 0.0

    @pydantic.model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.mean is None) == (self.share is None):
            raise ValueError("agrees: give either mean and sd, or share")
        if (self.mean is None) != (self.sd is None):
            raise ValueError("mean and sd: give both or neither")
        if self.share is not None and self.tolerance is not None and self.tolerance >= 1:
            raise ValueError(f"tolerance: got {self.tolerance:g}; allowed for a share: < 1")
        if self.sd == 0 and self.tolerance is None:
            raise ValueError("tolerance: required because sd is 0")
        return self


class Latency(Test, frozen=True):
    """Whether an advance of a single run takes less than a time, or how several compare.

    `bojax bench latency DIR` measures it for a results folder.
    """

    target: ClassVar[str] = "bojax.claims.latency:latency"

    kind: Literal["latency"] = "latency"
    labels: tuple[str, ...] = Field(
        strict=False,
        min_length=1,
        description="labels or variants, that with the least time first unless factor is given",
    )
    below: float | None = Field(
        default=None, gt=0, description="seconds that an advance of the only label stays under"
    )
    factor: float | None = Field(
        default=None,
        gt=1,
        description="limit of the ratios of the first label's time to the others, and of their inverses",
    )

    @pydantic.model_validator(mode="after")
    def _bound_or_order(self) -> Self:
        _distinct(self.labels, "labels")
        if (len(self.labels) == 1) != (self.below is not None):
            raise ValueError("latency: give either one label and below, or several labels")
        if self.below is not None and self.factor is not None:
            raise ValueError("latency: give either below or factor")
        return self


class Growth(OfOneLabel, frozen=True):
    """Whether the mean of a column grows with a swept number by the expected law rather than by another."""

    target: ClassVar[str] = "bojax.claims.growth:growth"

    kind: Literal["growth"] = "growth"
    column: str = Field(description="a column of runs.parquet with positive means")
    over: str = Field(description="swept number, a dotted path such as env.length")
    expected: Literal["linear", "quadratic", "exponential"] = Field(
        description="law: a + b x, a + b x^2 or a exp(b x)"
    )
    missing: _Missing = 0.05
