"""One page over several results folders: every claim of the thesis with its verdict, machine and time."""

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bojax.claims.collected import collected
from bojax.report.manifest import Manifest
from bojax.report.source import Results, load
from bojax.report.template import fill
from bojax.report.text import counted, joined
from bojax.report.text import seconds as in_seconds
from bojax.report.verdicts import (
    Explained,
    TestedClaim,
    causes_of,
    explanations_of,
    in_words,
    read_claims,
    tally,
)
from bojax.results.store import ResultsError, make_folder, write_content
from bojax.text import error_line

CHAPTERS = {
    3: "Bayesian optimisation for sequential planning",
    4: "Sequential planning with continuous actions",
    5: "Bayesian optimisation for reinforcement learning",
}
"""Chapters of the thesis with claims."""

PAGE = "reproduction.html"
TEXT = "reproduction.md"

Origin = tuple[tuple[str, str], ...]  # names and texts of what results were made by

_NOTE = (
    "Bounds, margins and windows that the thesis does not print are choices of bojax. They follow the word "
    '"here" in the column of the thesis; take them as set after a first look at results.'
)

_PLACES = re.compile(r" --(?:resume|(?:out|devices|launcher)[ =](?:'[^']*'|\S+))")
"""Options of a command that say where it ran: results do not depend on them."""

_COUNTS = re.compile(
    r"Of\s+\d+(\s+claims.*?)\d+(\s+are\s+reproduced,\s+)\d+(\s+are\s+not,\s+and\s+)\d+(?=\s+are\s+inconclusive)",
    re.DOTALL,
)
"""The sentence on claims of another page."""

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
    claims: Sequence[TestedClaim]
    explanations: Sequence[Explained]  # of the claims that are not reproduced, or inconclusive
    report: str  # address of its report, relative to the page; empty without a report

    @classmethod
    def of(cls, results: Results, claims: Sequence[TestedClaim], folder: Path) -> "Sweep":
        """The sweep of some results, on a page in a folder."""
        report, manifest = results.folder / "report.html", results.manifest
        address = quote(_relative(report, folder)) if report.is_file() else ""
        return cls(manifest, claims, explanations_of(manifest, claims), address)

    @property
    def origin(self) -> Origin:
        """The command that made it, with which code and packages."""
        known = self.manifest.provenance
        command = _PLACES.sub("", self.manifest.command)
        return (("command", command), *((key, known[key]) for key in ("revision", "versions")))


@dataclass(frozen=True)
class Row:
    """A claim in the table of a chapter."""

    sweep: Sweep
    claim: TestedClaim
    chapter: int  # its chapter; 0 if nothing says which
    order: tuple[Any, ...]  # chapters, and in each figures before tables before sections, all by number
    reference: str  # the figure, table or section
    page: str  # the page of the PDF; empty if the source names none
    other_source: str  # the source, if it is not in the thesis

    @classmethod
    def of(cls, sweep: Sweep, claim: TestedClaim) -> "Row":
        """The row of a claim, read off its source, or else its id or the name of the sweep."""
        source = claim.source or ""
        matches = [_REFERENCE.search(text) for text in (source, claim.id, sweep.manifest.name)]
        chapter, place, reference = "0", (), ""
        if match := next(filter(None, matches), None):
            kind, chapter, number, letter, part = match.groups(default="")
            numbers = [int(each) for each in number.split(".")]
            place = list(_KINDS).index(kind.lower()), numbers, letter, part
            reference = f"{_KINDS[kind.lower()]} {chapter}.{number}{letter}{f' ({part})' if part else ''}"
        page = _PAGE.search(source)
        other = "" if matches[0] else source
        order = int(chapter) or float("inf"), place
        return cls(sweep, claim, int(chapter), order, reference, page[1] if page else "", other)


def reproduction(folder: Path, sources: Sequence[Path], seconds: float) -> Path:
    """Write `reproduction.html` and `reproduction.md`, which has the same content without links to reports.

    The sources are results folders, each with the `claims.json` of its report. A folder that is missing,
    unfinished or damaged becomes one line of the page.
    `seconds` is the wall time of the command that ran them. The explanations of the sweeps
    (`report.explanations`) follow the tables, also if the results were made before they were written.
    """
    sweeps, gaps = [], []
    for source in map(Path, sources):
        try:
            results = load(source)
            sweeps.append(Sweep.of(results, read_claims(source), folder))
        except ResultsError as error:
            gaps.append((_relative(source, folder), str(error).removeprefix(f"{source}: ")))
    _write([folder / TEXT, folder / PAGE], sweeps, gaps, [("time taken", in_seconds(seconds))])
    return folder / PAGE


def joined_reproduction(
    pages: Sequence[Path], folders: Sequence[Path], names: Sequence[str], counted_in: Sequence[Path] = ()
) -> list[TestedClaim]:
    """Write pages on the newest results of each of some sweeps in several folders, and return their claims.

    The claims and tests are taken from this version, see `bojax.claims.collected`. Sweeps may have been made
    by different commands, revisions, devices and versions: the page says which command made each sweep.

    Pages are `.html` or `.md`, and say which of the named sweeps have no results, if most have. Other pages,
    `counted_in`, have a sentence "Of N claims ..., N are reproduced, N are not, and N are inconclusive",
    whose numbers are updated.
    """
    found = collected(folders, names)
    sweeps = [Sweep.of(results, claims, pages[0].parent) for results, claims, _ in found]
    missing = [name for name in names if all(name != sweep.manifest.name for sweep in sweeps)]
    is_partial = len(missing) > len(sweeps)  # a page on a few figures need not name all others
    gaps = [] if is_partial else [(name, "no finished results in these folders") for name in missing]
    claims = [claim for sweep in sweeps for claim in sweep.claims]
    kept = {results.manifest.name: number for results, _, number in found if number}
    whose = f"{counted(len(claims) - sum(kept.values()), 'claim')} decided by the tests of this version"
    if kept:
        whose += f", {sum(kept.values())} as in their reports, for want of tables ({joined(kept)})"
    others = {page: _recounted(page, claims) for page in counted_in}
    _write(pages, sweeps, gaps, [("verdicts", whose)])
    for page, text in others.items():
        write_content(page, text)
    return claims


def _recounted(page: Path, claims: Sequence[TestedClaim]) -> str:
    """A page with these numbers in its sentence on claims."""
    try:
        text = page.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ResultsError(f"{page}: cannot be read: {error_line(error)}") from error
    numbers = "Of {}\\g<1>{}\\g<2>{}\\g<3>{}".format(len(claims), *(count for _, _, count in tally(claims)))
    text, times = _COUNTS.subn(numbers, text)
    if times != 1:
        wanted = "Of N claims ..., N are reproduced, N are not, and N are inconclusive"
        raise ResultsError(f"{page}: got {counted(times, 'sentence')} on claims; allowed: one, {wanted}")
    return text


def _write(
    pages: Sequence[Path],
    sweeps: Sequence[Sweep],
    gaps: Sequence[tuple[str, str]],
    provenance: Sequence[tuple[str, str]],
) -> None:
    """Write pages on sweeps, each in the format of its suffix, with what else is known of the provenance."""
    for sweep in sweeps:
        if sweep.manifest.status == "failed":
            errors = dict.fromkeys(chunk.error for chunk in sweep.manifest.chunks if chunk.error)
            gaps = [
                *gaps,
                (sweep.manifest.name, f"some runs are missing: {'; '.join(errors) or 'unknown error'}"),
            ]
    claims = [claim for sweep in sweeps for claim in sweep.claims]
    rows = sorted(
        (Row.of(sweep, claim) for sweep in sweeps for claim in sweep.claims), key=lambda row: row.order
    )
    manifests = [sweep.manifest for sweep in sweeps]
    origins = list(
        dict.fromkeys(each.origin for each in sorted(sweeps, key=lambda sweep: sweep.manifest.written))
    )
    changed = sum(bool(claim.changed) for claim in claims)
    summary = [
        f"{counted(len(claims), 'claim')}, tested by {counted(len(sweeps), 'sweep')}: {in_words(claims)}.",
        causes_of(each for sweep in sweeps for each in sweep.explanations),
        f"{counted(changed, 'claim')} {'was' if changed == 1 else 'were'} tested with changed settings."
        if changed
        else "",
        f"Incomplete or left out: {counted(len(gaps), 'sweep')}." if gaps else "",
    ]
    values = {
        "title": "Reproduction of the thesis",
        "summary": " ".join(filter(None, summary)),
        "note": _NOTE,
        "counts": tally(claims),
        "gaps": gaps,
        "chapters": [_chapter(*each) for each in groupby(rows, key=lambda row: row.chapter)],
        "paragraphs": _paragraphs(sweeps, rows),
        "changes": _changes(manifests),
        "sweeps": sweeps,
        "origins": origins,
        "seconds": in_seconds,
        "compile_seconds": sum(manifest.compile_seconds for manifest in manifests),
        "run_seconds": sum(manifest.run_seconds for manifest in manifests),
        "provenance": [pair for pair in [*_provenance(sweeps, origins), *provenance] if pair[1]],
        "footer": "Written by bojax from the results folders, whose reports have the figures and the tests.",
    }
    for page in pages:
        make_folder(page.parent)
        write_content(page, fill(f"reproduction{page.suffix}.j2", **values))


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def _chapter(number: int, rows: Iterable[Row]) -> tuple[str, str, list[list[Row]]]:
    """Title, verdicts in words, and rows by figure, table or section, and sweep."""
    title = f"Chapter {number}{f': {CHAPTERS[number]}' if number in CHAPTERS else ''}"
    groups = [list(group) for _, group in groupby(rows, key=lambda row: (row.reference, id(row.sweep)))]
    verdicts = in_words([row.claim for group in groups for row in group])
    return title if number else "Other claims", f"{verdicts}.", groups


def _paragraphs(sweeps: Sequence[Sweep], rows: Sequence[Row]) -> list[tuple[str, Explained, list[Row]]]:
    """Each explanation with the rows of its claims, and their figures, tables and sections as its title."""
    found = []
    for sweep in sweeps:
        for each in sweep.explanations:
            members = [row for row in rows if row.sweep is sweep and row.claim in each.claims]
            title = joined(dict.fromkeys(row.reference or sweep.manifest.name for row in members))
            found.append((title, each, members))
    return sorted(found, key=lambda paragraph: paragraph[2][0].order)


def _changes(manifests: Iterable[Manifest]) -> list[tuple[str, str, str, str]]:
    """Settings that differ from the published ones: setting, published value, our value, sweeps."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for manifest in manifests:
        for change in manifest.changes:
            found.setdefault(change, []).append(manifest.name)
    return [(*change, joined(names)) for change, names in found.items()]


def _provenance(sweeps: Sequence[Sweep], origins: Sequence[Origin]) -> list[tuple[str, str]]:
    """What the sweeps were made by and on.

    What differs between commands is listed by their numbers, from 1. Devices and precisions are listed by
    sweep, since the sweeps of one command may run on several devices.
    """
    rows = []
    for key in dict(origins[0]) if origins else ():
        found: dict[str, list[str]] = {}
        for number, origin in enumerate(origins, 1):
            found.setdefault(dict(origin)[key], []).append(str(number))
        for text, numbers in found.items():
            which = f"{'command' if len(numbers) == 1 else 'commands'} {joined(numbers)}"
            if key == "command":
                rows.append((key if len(origins) == 1 else which, text))
            else:
                rows.append((key if len(found) == 1 else f"{key}, {which}", text))
    latest = max((sweep.manifest.written for sweep in sweeps), default="")
    said = [(key, _said(sweeps, key)) for key in ("device", "precision")]
    return [*rows, *said, ("last sweep written", latest)]


def _said(sweeps: Sequence[Sweep], key: str) -> str:
    """What manifests say of their provenance; different answers with the sweeps that give them."""
    found: dict[str, list[str]] = {}
    for sweep in sweeps:
        if text := sweep.manifest.provenance[key]:
            found.setdefault(text, []).append(sweep.manifest.name)
    if len(found) == 1:
        return next(iter(found))
    return "; ".join(f"{text} ({joined(names)})" for text, names in found.items())
