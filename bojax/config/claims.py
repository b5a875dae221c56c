"""Claims of the thesis, each with the statistical test that decides whether the results agree."""

from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field

from bojax.config.component import Registered, Schema, Slot


class Test(Registered, frozen=True):
    """A statistical test of a claim.

    `target` is the function that makes the test, `package.module:function`. It takes the results and these
    settings, and returns a `bojax.report.findings.Finding`.
    """

    role: ClassVar[str] = "test"
    target: ClassVar[str]

    by: Literal["label", "variant"] = Field(
        default="label",
        description="whether the test names labels or variants; a label with several variants is represented "
        "by the one with the best mean",
    )

    @property
    def names(self) -> tuple[str, ...]:
        """The labels or variants that the test compares: its settings `labels`, or `label` and `to`."""
        found = getattr(self, "labels", (getattr(self, "label", None), getattr(self, "to", None)))
        return tuple(name for name in found if name is not None)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that the test reads: its settings `column` and `also`."""
        column = getattr(self, "column", None)
        return () if column is None else (column, *getattr(self, "also", ()))

    @property
    def table(self) -> Literal["runs", "episodes", "steps"]:
        """The table of these columns: that of its windows of episodes or its steps, or else of runs."""
        values = dict(self)
        if any(isinstance(value, Window) for value in values.values()):
            return "episodes"
        return "runs" if values.get("step", values.get("first")) is None else "steps"


class Window(Schema, frozen=True):
    """Episodes over which a column of episodes.parquet is averaged within a run."""

    first: int = Field(alias="from", ge=1, description="first episode, counted from 1")
    last: int = Field(alias="to", ge=1, description="last episode, inclusive")
    phase: Literal["train", "test"] = Field(
        default="train", description="training episodes, or the test episodes that follow each of them"
    )

    counted_from: Literal["start", "first-success"] = Field(
        default="start",
        description="whether episode 1 is the first of the run, or its first training episode with a success",
    )
    missing: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="largest share of runs that may lack these episodes and are left out, if episodes are "
        "counted from the first success",
    )

    @pydantic.model_validator(mode="after")
    def _forward(self) -> Self:
        if self.missing and self.counted_from == "start":
            raise ValueError("missing: needs counted_from: first-success")
        if self.first > self.last:
            raise ValueError(f"to must not lie before from, which is {self.first}")
        return self


EntryClass = Literal["claim", "variant", "check"]
"""What an entry is: a claim of the thesis, the same under other settings, or a check of something else."""


class Claim(Schema, frozen=True):
    """One statement, with the test that decides it."""

    id: str = Field(min_length=1, description="unique in the sweep")
    source: str = Field(description="figure or table, and page")
    claim: str = Field(description="statement in words")
    thesis: str | float | None = Field(
        default=None, union_mode="left_to_right", description="value in the thesis, a number or text"
    )
    entry_class: EntryClass = Field(
        default="claim",
        alias="class",
        description="claim: a statement of the thesis, or of the publication that source names, under the "
        "settings of the sweep; variant: the same under other settings, or by another test; check: in no "
        "publication (the author's code, an exact value, a consistency). Only claims are counted",
    )
    own_bound: bool = Field(
        default=False,
        description="whether the verdict rests on a bound, margin or window that the thesis does not print",
    )
    test: Annotated[Test, Slot("test")] = Field(description="test that decides the claim")


Cause = Literal["choice", "slip", "few-runs", "unexplained"]


class Explanation(Schema, frozen=True):
    """Why claims of a sweep are not reproduced or inconclusive, in one paragraph."""

    claims: tuple[str, ...] = Field(strict=False, min_length=1, description="ids of claims of the sweep")
    cause: Cause = Field(
        description="choice: one that the thesis leaves open; slip: an error in the thesis or in the code "
        "behind it; few-runs: too few printed runs to tell the difference from chance; unexplained: nothing "
        "that was tried has shown a cause"
    )
    text: str = Field(
        min_length=1, description="cause and evidence, a paragraph; results are references in braces"
    )
    sweeps: tuple[str, ...] = Field(
        default=(), strict=False, description="names of the sweeps whose results are the evidence"
    )
