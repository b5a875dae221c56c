"""The entries of `claims.json` as pages and the terminal show them, and why claims are not reproduced."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bojax.config.claims import Cause
from bojax.config.errors import printable
from bojax.config.sweep_file import published_report
from bojax.report.findings import Verdict
from bojax.report.manifest import Bounds, Count, Manifest, Recorded, validated
from bojax.report.statistics import Interval
from bojax.report.text import MISSING, counted, joined, plain
from bojax.results.store import read_json

CLAIMS = "claims.json"

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

    kind: Any = None
    share: Any = None
    column: Any = None
    window: Any = None
    to: Any = None
    greater: Any = None
    method: str = ""
    reason: str = ""
    comparisons: list[ComparisonEntry] = []
    chosen: dict[str, str] = {}


class TestedClaim(Recorded):
    """A claim with its verdict; the properties are texts for pages."""

    id: str
    claim: str
    source: str | None
    thesis: Any
    changed: dict[str, Any]
    ours: float | str | None
    interval: Bounds | None
    runs: Count
    verdict: Verdict
    test: TestEntry

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
        test = self.test
        extreme = "least" if test.kind == "order" and test.greater is None else "greatest"
        # The same rule as in `stand_ins` of `bojax.claims.samples`.
        is_own = test.kind == "order" or isinstance(test.window or test.to, dict)
        column = test.column if is_own else "return"
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
        is_share = self.test.kind == "share" or self.test.share is not None
        return Interval(estimate, *interval).in_words(as_percent=is_share)


def read_claims(folder: Path) -> list[TestedClaim]:
    """The claims in the `claims.json` that a report wrote into a results folder."""
    path = folder / CLAIMS
    return validated(list[TestedClaim], read_json(path), str(path))


def tally(claims: Sequence[TestedClaim]) -> list[tuple[Verdict, str, int]]:
    """Each verdict with its mark and the number of claims that have it."""
    return [(verdict, mark, sum(c.verdict == verdict for c in claims)) for verdict, mark in MARKS.items()]


def in_words(claims: Sequence[TestedClaim]) -> str:
    """The number of each verdict: `2 reproduced, 0 not reproduced and 1 inconclusive`."""
    return joined(f"{count} {verdict}" for verdict, _, count in tally(claims))


def print_verdicts(folder: Path, *, is_brief: bool = False) -> None:
    """Print the verdicts of a results folder on standard error; nothing of a sweep without claims.

    There is one line per claim, unless `is_brief`, and one with the number of each verdict.
    """
    claims = read_claims(folder) if (folder / CLAIMS).is_file() else []
    for claim in () if is_brief else claims:
        reason = f" ({claim.test.reason})" if claim.test.reason else ""
        told = printable(f"{claim.id}: {claim.claim}{reason}")
        print(f"{claim.verdict:<14}  {told}", file=sys.stderr)
    if claims:
        told = f"{folder}: {counted(len(claims), 'claim')}: {in_words(claims)}"
        print(printable(told), file=sys.stderr)


CAUSES: dict[Cause | Literal["untested"], str] = {
    "choice": "a choice that the thesis leaves open",
    "slip": "a slip of the thesis",
    "few-runs": "too few printed runs",
    "unexplained": "unexplained",
    "untested": "not tested",
}
"""Each cause in words. A claim is untested if these results have too few runs, or lack a table."""


@dataclass(frozen=True)
class Explained:
    """An explanation in these results."""

    cause: Cause | Literal["untested"]
    text: str  # a paragraph; empty if the sweep has no explanation
    sweeps: Sequence[str]  # whose results are the evidence
    claims: Sequence[TestedClaim]  # that it explains and that are not reproduced, or inconclusive

    @property
    def cause_in_words(self) -> str:
        """The cause as pages show it."""
        return CAUSES[self.cause]


def explanations_of(manifest: Manifest, claims: Sequence[TestedClaim]) -> list[Explained]:
    """The explanations of those claims that are not reproduced, or inconclusive, in the order of the sweep.

    A sweep that is part of bojax has the explanations of this version, which may be later than the results.
    Any other sweep, even one of the same name, has the explanations in its manifest. Claims without an
    explanation come last: those that could not be tested, and those that are unexplained.
    """
    published = published_report(manifest.name) if manifest.is_published else None
    report = published or manifest.report
    left = [claim for claim in claims if claim.verdict != "reproduced"]
    found = []
    for each in report.explanations:
        if members := [claim for claim in left if claim.id in each.claims]:
            found.append(Explained(each.cause, each.text.strip(), each.sweeps, members))
        left = [claim for claim in left if claim.id not in each.claims]
    untested = [claim for claim in left if claim.test.reason]
    unexplained = [claim for claim in left if not claim.test.reason]
    rest = Explained("unexplained", "", (), unexplained), Explained("untested", "", (), untested)
    return [*found, *(each for each in rest if each.claims)]


def causes_of(explanations: Iterable[Explained]) -> str:
    """How many claims have which cause, a sentence for each verdict; empty if all are reproduced."""
    pairs = [(claim.verdict, each.cause) for each in explanations for claim in each.claims]
    sentences = []
    for verdict in ("not reproduced", "inconclusive"):
        causes = [cause for of, cause in pairs if of == verdict]
        counts = [f"{causes.count(cause)} {text}" for cause, text in CAUSES.items() if cause in causes]
        if counts:
            sentences.append(f"Causes of the {len(causes)} {verdict}: {joined(counts)}.")
    return " ".join(sentences)
