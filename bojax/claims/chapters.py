"""The claims of a page over several results folders, by chapter, and by figure, table or section."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bojax.report.explanations import AtHand, Explained, explanations_of
from bojax.report.manifest import Manifest
from bojax.report.verdicts import TestedClaim, claims_among, verdicts_in_words

CHAPTERS = {
    3: "Bayesian optimisation for sequential planning",
    4: "Sequential planning with continuous actions",
    5: "Bayesian optimisation for reinforcement learning",
}
"""Chapters of the thesis with claims."""

Origin = tuple[tuple[str, str], ...]  # names and texts of what results were made by

_PLACES = re.compile(r" --(?:resume|(?:out|devices|launcher)[ =](?:'[^']*'|\S+))")
"""Options of a command that say where it ran: results do not depend on them."""

_KINDS = {"fig": "Fig.", "table": "Table", "section": "Section"}
_REFERENCE = re.compile(
    r"\b(fig|table|section)\W+(\d+)\.(\d+(?:\.\d+)*)([a-z]?)\b(?: \((\w+)\))?", re.IGNORECASE
)
"""`Fig. 5.4 (top)` in the source of a claim, `table-5.3` in its id."""
_PAGE = re.compile(r"\bp\. (\d+(?:-\d+)?)")


@dataclass(frozen=True)
class Sweep:
    """A results folder with claims."""

    manifest: Manifest
    entries: Sequence[TestedClaim]
    explanations: Sequence[Explained]  # of the claims that are not reproduced, or inconclusive
    report: str  # address of its report, relative to the page; empty without a report

    @classmethod
    def of(cls, source: AtHand, others: Mapping[str, AtHand], folder: Path) -> "Sweep":
        """The sweep of some results, on a page in a folder; explanations refer to others by name."""
        report = source.results.folder / "report.html"
        address = quote(relative(report, folder)) if report.is_file() else ""
        return cls(source.results.manifest, source.claims, explanations_of(source, others), address)

    @property
    def claims(self) -> list[TestedClaim]:
        """The entries that are claims."""
        return claims_among(self.entries)

    @property
    def origin(self) -> Origin:
        """The command that made it, with which code and packages."""
        known = self.manifest.provenance
        command = _PLACES.sub("", self.manifest.command)
        return (("command", command), *((key, known[key]) for key in ("revision", "versions")))


@dataclass(frozen=True)
class Row:
    """An entry of a sweep on the pages."""

    sweep: Sweep
    claim: TestedClaim
    explained: Explained | None  # why it is not reproduced, or inconclusive
    chapter: int  # its chapter; 0 if nothing says which
    order: tuple[Any, ...]  # chapters, and in each figures before tables before sections, all by number
    reference: str  # the figure, table or section; else the name of the sweep
    page: str  # the page of the PDF; empty if the source names none
    other_source: str  # the source, if it is not in the thesis

    @classmethod
    def of(cls, sweep: Sweep, claim: TestedClaim) -> "Row":
        """The row of a claim, read off its source, or else its id or the name of the sweep."""
        source = claim.source or ""
        matches = [_REFERENCE.search(text) for text in (source, claim.id, sweep.manifest.name)]
        chapter, place, reference = "0", (), sweep.manifest.name
        if match := next(filter(None, matches), None):
            kind, chapter, number, letter, part = match.groups(default="")
            numbers = [int(each) for each in number.split(".")]
            place = list(_KINDS).index(kind.lower()), numbers, letter, part
            reference = f"{_KINDS[kind.lower()]} {chapter}.{number}{letter}{f' ({part})' if part else ''}"
        page = _PAGE.search(source)
        other = "" if matches[0] else source
        order = int(chapter) or float("inf"), place
        explained = next((each for each in sweep.explanations if claim in each.claims), None)
        return cls(sweep, claim, explained, int(chapter), order, reference, page[1] if page else "", other)

    @property
    def source(self) -> str:
        """Figure, table or section, and page."""
        if self.other_source:
            return self.other_source
        return f"{self.reference}, p. {self.page}" if self.page else self.reference

    @property
    def anchor(self) -> str:
        """Its place in the page of its chapter."""
        name, claim = self.sweep.manifest.name, self.claim.id  # an id is unique in its sweep
        return _anchor(claim if claim.startswith(f"{name}/") else f"{name}-{claim}")


@dataclass(frozen=True)
class Figure:
    """A figure, table or section with its claims, and the variants and checks that belong to it."""

    title: str
    claims: Sequence[Row]
    others: Sequence[Row]

    @property
    def anchor(self) -> str:
        """Its place in the page of its chapter."""
        return _anchor(self.title)


@dataclass(frozen=True)
class Chapter:
    """A chapter of the thesis, or what belongs to none."""

    title: str
    file: str  # name of its page, without a suffix
    figures: Sequence[Figure]

    @classmethod
    def of(cls, number: int, rows: Iterable[Row]) -> "Chapter":
        """The chapter of a number, 0 for none, whose rows are in order."""
        figures = []
        for title, group in groupby(rows, key=lambda row: row.reference):
            members = list(group)
            claims = [row for row in members if row.claim.is_claim]
            figures.append(Figure(title, claims, [row for row in members if not row.claim.is_claim]))
        title = f"Chapter {number}{f': {CHAPTERS[number]}' if number in CHAPTERS else ''}"
        return cls(*((title, f"chapter{number}") if number else ("Other claims", "other")), figures)

    @property
    def rows(self) -> list[Row]:
        """All rows in the order of its page."""
        return [row for figure in self.figures for row in (*figure.claims, *figure.others)]

    @property
    def claims(self) -> list[Row]:
        """The rows of claims."""
        return [row for row in self.rows if row.claim.is_claim]

    @property
    def verdicts(self) -> str:
        """The number of each verdict."""
        return verdicts_in_words([row.claim for row in self.rows])

    def is_ambiguous(self, row: Row) -> bool:
        """Whether several sweeps test claims of its figure, so that it needs the name of its sweep."""
        return any(each.reference == row.reference and each.sweep is not row.sweep for each in self.claims)

    def told_at(self, row: Row) -> Row:
        """The first row of the page with the explanation of a row, where its text is."""
        return next(each for each in self.rows if each.explained is row.explained)


def _anchor(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def relative(path: Path, folder: Path) -> str:
    """The address of a path for a page in a folder."""
    return Path(os.path.relpath(path, folder)).as_posix()
