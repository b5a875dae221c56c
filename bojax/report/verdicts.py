"""The entries of `claims.json` as a page shows them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from bojax.report.claims.finding import Verdict
from bojax.report.manifest import Count, Part, validated
from bojax.report.text import MISSING, percent, plain, with_bounds
from bojax.results.store import read_json

CLAIMS = "claims.json"

MARKS: dict[Verdict, str] = {
    "reproduced": "\N{CHECK MARK}",
    "not reproduced": "\N{MULTIPLICATION SIGN}",
    "inconclusive": "?",
}

Bounds = Annotated[list[float], Field(min_length=2, max_length=2)]


class ComparisonEntry(Part):
    """One statement behind a claim."""

    of: str
    estimate: float
    interval: Bounds


class TestEntry(Part):
    """The test of a claim: how it decided, or why it could not be made."""

    kind: Any = None
    share: Any = None
    method: str = ""
    reason: str = ""
    comparisons: list[ComparisonEntry] = []
    chosen: dict[str, str] = {}


class TestedClaim(Part):
    """A claim with its verdict."""

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
        """A character for the verdict."""
        return MARKS[self.verdict]

    @property
    def printed(self) -> str:
        """The thesis's value; empty without one."""
        return "" if self.thesis is None else plain(self.thesis)

    @property
    def found(self) -> str:
        """Our value."""
        if isinstance(self.ours, float) and self.interval is not None:
            return self._bounds(self.ours, self.interval)[0]
        return MISSING if self.ours is None else str(self.ours)

    @property
    def own_interval(self) -> str:
        """The interval of our value; empty if the intervals are of differences or ratios."""
        return self._told(self.test.comparisons[0])[2] if self._is_single else ""

    @property
    def comparisons(self) -> list[tuple[str, str, str]]:
        """The statements tested, each with estimate and interval; none if `own_interval` says everything."""
        return [] if self._is_single else [self._told(each) for each in self.test.comparisons]

    @property
    def decisive(self) -> tuple[str, str, str] | None:
        """The one of `comparisons` whose interval represents the claim."""
        found = (each for each in self.test.comparisons if each.interval == self.interval)
        return None if self._is_single or (each := next(found, None)) is None else self._told(each)

    @property
    def stand_ins(self) -> list[str]:
        """Sentences on the variants that represent labels."""
        return [
            f"{label} is represented by {variant}, the variant with the best mean"
            for label, variant in self.test.chosen.items()
            if variant != label
        ]

    @property
    def _is_single(self) -> bool:
        return len(self.test.comparisons) == 1 and self.test.comparisons[0].estimate == self.ours

    def _told(self, each: ComparisonEntry) -> tuple[str, str, str]:
        return each.of.replace(" - ", " \N{MINUS SIGN} "), *self._bounds(each.estimate, each.interval)

    def _bounds(self, estimate: float, interval: Sequence[float]) -> tuple[str, str]:
        if self.test.kind == "share" or self.test.share is not None:
            low, high = map(percent, interval)
            return percent(estimate), f"[{low}, {high}]"
        low, high = interval
        return with_bounds(estimate, low, high)


def read_claims(folder: Path) -> list[TestedClaim]:
    """The claims of a results folder, tested by an earlier report.

    Raises:
        ResultsError: There is no `claims.json`, or it is damaged; one line.
    """
    path = folder / CLAIMS
    return validated(list[TestedClaim], read_json(path), str(path))


def tally(claims: Sequence[TestedClaim]) -> list[tuple[Verdict, str, int]]:
    """Each verdict with its mark and its number of claims."""
    return [(verdict, mark, sum(c.verdict == verdict for c in claims)) for verdict, mark in MARKS.items()]
