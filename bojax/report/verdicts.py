"""The entries of `claims.json`, and how pages and the terminal show them."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_serializer

from bojax.config.claims import Cause, EntryClass
from bojax.config.errors import printable, say
from bojax.report.manifest import Bounds, Count, Fraction, Recorded, validated
from bojax.report.statistics import Interval
from bojax.report.text import MISSING, counted, joined, percent, plain
from bojax.results.store import read_json

CLAIMS = "claims.json"

Verdict = Literal["reproduced", "not reproduced", "inconclusive"]

FailureCause = Cause | Literal["untested"]
"""Why a claim is not reproduced, or inconclusive: the cause of the explanation that names it. Without one, it
is untested if the results have too few runs or lack a table, and otherwise unexplained."""

MARKS: dict[Verdict, str] = {
    "reproduced": "\N{CHECK MARK}",
    "not reproduced": "\N{MULTIPLICATION SIGN}",
    "inconclusive": "?",
}


class ComparisonEntry(Recorded):
    """One of the comparisons that decide a claim."""

    of: str
    estimate: float
    interval: Bounds


class TestEntry(Recorded):
    """The test of a claim, with its method and comparisons, or with the reason why it was not possible."""

    method: str = ""
    comparisons: list[ComparisonEntry] = []
    chosen: dict[str, str] = {}  # the variant that represents each label with several variants
    reason: str = ""

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the test."""
        return self.model_extra or {}

    @model_serializer
    def _written(self) -> dict[str, Any]:
        found = ("reason",) if self.reason else ("method", "comparisons", "chosen")
        return {**self.settings, **{name: getattr(self, name) for name in found}}


class TestedClaim(Recorded):
    """An entry of a sweep with its verdict; the properties are texts for pages. Only claims are counted."""

    id: str
    source: str | None
    claim: str
    entry_class: EntryClass = Field(default="claim", alias="class")  # earlier versions had claims only
    cause: FailureCause | None = None  # none of a reproduced claim
    own_bound: bool = False
    thesis: Any
    ours: float | str | None
    interval: Bounds | None
    runs: Count
    verdict: Verdict
    share: Fraction | None = None  # of the configurations of a multiverse in which the claim holds
    configurations: Count | None = None
    changed: dict[str, Any]
    test: TestEntry

    @property
    def is_claim(self) -> bool:
        """Whether it is a statement of the thesis, which is counted, rather than a variant or a check."""
        return self.entry_class == "claim"

    @property
    def robustness(self) -> str:
        """The share of configurations in which the claim holds; empty if unknown."""
        if self.share is None or self.configurations is None:
            return ""
        return f"{percent(self.share)} of {self.configurations:,}"

    @property
    def mark(self) -> str:
        """The character that stands for the verdict."""
        return MARKS[self.verdict]

    @property
    def printed(self) -> str:
        """The value in the thesis; empty if it gives none."""
        return "" if self.thesis is None else plain(self.thesis)

    @property
    def found(self) -> str:
        """The value in these results."""
        if isinstance(self.ours, float) and self.interval is not None:
            return self._formatted(self.ours, self.interval)[0]
        return MISSING if self.ours is None else str(self.ours)

    @property
    def own_interval(self) -> str:
        """The interval of `found`; empty if the test compares differences or ratios instead."""
        return self._row(self.test.comparisons[0])[2] if self._is_single else ""

    @property
    def comparisons(self) -> list[tuple[str, str, str]]:
        """Name, estimate and interval of each comparison; none if `own_interval` is the only interval."""
        return [] if self._is_single else [self._row(each) for each in self.test.comparisons]

    @property
    def decisive(self) -> tuple[str, str, str] | None:
        """The entry of `comparisons` with the interval of the claim."""
        rows = zip(self.comparisons, self.test.comparisons, strict=False)
        return next((row for row, each in rows if each.interval == self.interval), None)

    @property
    def stand_ins(self) -> list[str]:
        """A sentence, without its full stop, for each label that one of several variants represents."""
        test = self.test.settings
        is_order = test.get("kind") == "order"
        extreme = "least" if is_order and test.get("greater") is None else "greatest"
        # The same rule as in `stand_ins` of `bojax.claims.samples`.
        is_own = is_order or isinstance(test.get("window") or test.get("to"), dict)
        column = test.get("column") if is_own else "return"
        return [
            f"{label} is represented by {variant}, the variant with the {extreme} mean {column}"
            for label, variant in self.test.chosen.items()
            if variant != label
        ]

    @property
    def _is_single(self) -> bool:
        return len(self.test.comparisons) == 1 and self.test.comparisons[0].estimate == self.ours

    def _row(self, each: ComparisonEntry) -> tuple[str, str, str]:
        name = each.of.replace(" - ", " \N{MINUS SIGN} ")
        return name, *self._formatted(each.estimate, each.interval)

    def _formatted(self, estimate: float, interval: Sequence[float]) -> tuple[str, str]:
        """An estimate and its interval; as percentages if the test is of a share."""
        test = self.test.settings
        is_share = test.get("kind") == "share" or test.get("share") is not None
        return Interval(estimate, *interval).in_words(as_percent=is_share)


def read_claims(folder: Path) -> list[TestedClaim]:
    """The claims in the `claims.json` that a report wrote into a results folder."""
    path = folder / CLAIMS
    return validated(list[TestedClaim], read_json(path), str(path))


def claims_among(entries: Iterable[TestedClaim]) -> list[TestedClaim]:
    """The entries that are claims, which alone are counted: neither variants nor checks."""
    return [entry for entry in entries if entry.is_claim]


def tally(entries: Iterable[TestedClaim]) -> list[tuple[Verdict, str, int]]:
    """Each verdict with its mark and the number of claims among the entries that have it."""
    claims = claims_among(entries)
    return [(verdict, mark, sum(c.verdict == verdict for c in claims)) for verdict, mark in MARKS.items()]


def verdicts_in_words(entries: Iterable[TestedClaim]) -> str:
    """The number of claims with each verdict: `2 reproduced, 0 not reproduced and 1 inconclusive`."""
    return joined(f"{count} {verdict}" for verdict, _, count in tally(entries))


def in_words(entries: Sequence[TestedClaim]) -> str:
    """The number of claims and their verdicts, and the number of other entries."""
    claims = claims_among(entries)
    others = len(entries) - len(claims)
    parts = [f"{counted(len(claims), 'claim')}: {verdicts_in_words(claims)}"] if claims or not others else []
    parts += [f"{others} variant{'s' * (others > 1)} or check{'s' * (others > 1)}"] if others else []
    return "; ".join(parts)


def print_verdicts(folder: Path, *, is_brief: bool = False) -> None:
    """Print the verdicts of a results folder on standard error; nothing of a sweep without claims.

    There is one line per entry, unless `is_brief`, and one with the number of each verdict.
    """
    claims = read_claims(folder) if (folder / CLAIMS).is_file() else []
    for claim in () if is_brief else claims:
        notes = [] if claim.is_claim else [claim.entry_class]
        notes += [claim.test.reason] if claim.test.reason else []
        aside = f" ({'; '.join(notes)})" if notes else ""
        told = printable(f"{claim.id}: {claim.claim}{aside}")
        print(f"{claim.verdict:<14}  {told}", file=sys.stderr)
    if claims:
        say(f"{folder}: {in_words(claims)}")
