"""One page over several results folders: every claim of the thesis with its verdict, machine and time."""

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bojax.report.manifest import Manifest
from bojax.report.source import load
from bojax.report.template import fill
from bojax.report.text import counted, joined, line, seconds
from bojax.report.verdicts import TestedClaim, read_claims, tally
from bojax.results.store import ResultsError, explained, write_atomically

CHAPTERS = {
    3: "Bayesian optimisation for sequential planning",
    4: "Sequential planning with continuous actions",
    5: "Bayesian optimisation for reinforcement learning",
}
"""Chapters of the thesis with claims."""

PAGE = "reproduction.html"
TEXT = "reproduction.md"

_KINDS = ("fig", "table", "section")
_REFERENCE = re.compile(
    r"\b(fig|table|section)\W+(\d+)\.(\d+(?:\.\d+)*)([a-z]?)\b(?: \((\w+)\))?", re.IGNORECASE
)
"""`Fig. 5.4 (top)` in the source of a claim, `table-5.3` in its id."""
_PAGE = re.compile(r"\bp\. (\d+(?:-\d+)?)")


@dataclass(frozen=True)
class Sweep:
    """A results folder with claims.

    Attributes:
        manifest: Its manifest.
        claims: Its claims.
        report: Address of its report, relative to the page; empty if there is none.
    """

    manifest: Manifest
    claims: Sequence[TestedClaim]
    report: str

    @property
    def name(self) -> str:
        """Its name."""
        return self.manifest.name or ""


@dataclass(frozen=True)
class Row:
    """A claim in the table of a chapter."""

    sweep: Sweep
    claim: TestedClaim

    @cached_property
    def _match(self) -> re.Match[str] | None:
        texts = (self.claim.source or "", self.claim.id, self.sweep.name)
        return next((match for text in texts if (match := _REFERENCE.search(text))), None)

    @property
    def chapter(self) -> int:
        """Its chapter; 0 if nothing says which."""
        return int(self._match[2]) if self._match else 0

    @property
    def place(self) -> tuple[Any, ...]:
        """What rows are sorted by: figures before tables before sections, each by number."""
        if self._match is None:
            return ()
        kind, _, number, letter, part = self._match.groups(default="")
        return _KINDS.index(kind.lower()), [int(each) for each in number.split(".")], letter, part

    @property
    def reference(self) -> str:
        """The figure, table or section."""
        if self._match is None:
            return ""
        kind, chapter, number, letter, part = self._match.groups(default="")
        name = {"fig": "Fig.", "table": "Table", "section": "Section"}[kind.lower()]
        return f"{name} {chapter}.{number}{letter}{f' ({part})' if part else ''}"

    @property
    def page(self) -> str:
        """The page of the PDF; empty if the source names none."""
        match = _PAGE.search(self.claim.source or "")
        return match[1] if match else ""

    @property
    def other_source(self) -> str:
        """The source, if it is not in the thesis."""
        source = self.claim.source or ""
        return "" if _REFERENCE.search(source) else source


@dataclass(frozen=True)
class Chapter:
    """The claims of a chapter, in the order of its figures, tables and sections."""

    title: str
    rows: Sequence[Row]

    @property
    def summary(self) -> str:
        """The numbers of its verdicts in words."""
        return f"{_verdicts([row.claim for row in self.rows])}."

    @property
    def groups(self) -> list[tuple[str, Sweep, list[Row]]]:
        """Its rows by figure, table or section, and sweep."""
        found: dict[tuple[str, int], list[Row]] = {}
        for row in self.rows:
            found.setdefault((row.reference, id(row.sweep)), []).append(row)
        return [(reference, rows[0].sweep, rows) for (reference, _), rows in found.items()]


def reproduction(
    folder: Path, sources: Sequence[Path], command: str, seconds: float, skipped: Mapping[str, str] = {}
) -> Path:
    """Write `reproduction.html` and `reproduction.md`, which has the same content without links to reports.

    A results folder that is missing, unfinished or damaged becomes one line of the page.

    Args:
        folder: Where they are written; made if it is not there.
        sources: Results folders, each with the `claims.json` of its report.
        command: The command line that ran the sweeps.
        seconds: Wall time of the command.
        skipped: The reason for each sweep that was not run, by name.

    Raises:
        ResultsError: The files cannot be written; one line.
    """
    sweeps, gaps = [], list(skipped.items())
    for source in map(Path, sources):
        try:
            sweep = _read(source, folder)
        except ResultsError as error:
            gaps.append((_relative(source, folder), str(error).removeprefix(f"{source}: ")))
            continue
        sweeps.append(sweep)
        if sweep.manifest.status == "failed":
            errors = dict.fromkeys(chunk.error for chunk in sweep.manifest.chunks if chunk.error)
            gaps.append((sweep.name, f"some runs are missing: {'; '.join(errors) or 'unknown error'}"))
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    values = _content(sweeps, gaps, command, seconds)
    for name in (TEXT, PAGE):
        text = fill(f"{name}.j2", **values).encode()
        write_atomically(folder / name, lambda temporary, text=text: temporary.write_bytes(text))
    return folder / PAGE


def _read(source: Path, folder: Path) -> Sweep:
    results = load(source)
    manifest = results.manifest.model_copy(update={"name": results.name, "title": results.title})
    report = source / "report.html"
    return Sweep(manifest, read_claims(source), quote(_relative(report, folder)) if report.is_file() else "")


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def _content(
    sweeps: Sequence[Sweep], gaps: Sequence[tuple[str, str]], command: str, wall_seconds: float
) -> dict[str, Any]:
    """What the templates show."""
    claims = [claim for sweep in sweeps for claim in sweep.claims]
    manifests = [sweep.manifest for sweep in sweeps]
    changed = sum(bool(claim.changed) for claim in claims)
    summary = [
        f"{counted(len(claims), 'claim')}, tested by {counted(len(sweeps), 'sweep')}: {_verdicts(claims)}.",
        f"{counted(changed, 'claim')} {'was' if changed == 1 else 'were'} tested with changed settings."
        if changed
        else "",
        f"Incomplete or left out: {counted(len(gaps), 'sweep')}." if gaps else "",
    ]
    provenance = [
        ("command", command),
        ("time taken", seconds(wall_seconds)),
        ("last sweep written", max((manifest.written or "" for manifest in manifests), default="")),
        ("revision", _said(sweeps, lambda manifest: manifest.revision)),
        ("device", _said(sweeps, lambda manifest: line(manifest.device))),
        ("versions", _said(sweeps, lambda manifest: line(manifest.versions))),
        ("precision", _said(sweeps, lambda manifest: line(manifest.precision))),
    ]
    return {
        "title": "Reproduction of the thesis",
        "summary": " ".join(filter(None, summary)),
        "counts": tally(claims),
        "gaps": gaps,
        "chapters": _chapters(sweeps),
        "changes": _changes(manifests),
        "sweeps": sweeps,
        "seconds": seconds,
        "compile_seconds": sum(manifest.compile_seconds for manifest in manifests),
        "run_seconds": sum(manifest.run_seconds for manifest in manifests),
        "provenance": [(key, value) for key, value in provenance if value],
        "footer": "Written by bojax from the results folders, whose reports have the figures and the tests.",
    }


def _chapters(sweeps: Sequence[Sweep]) -> list[Chapter]:
    rows = [Row(sweep, claim) for sweep in sweeps for claim in sweep.claims]
    numbers = sorted({row.chapter for row in rows}, key=lambda number: number or float("inf"))
    titles = {
        number: f"Chapter {number}{f': {CHAPTERS[number]}' if number in CHAPTERS else ''}"
        for number in numbers
    }
    return [
        Chapter(
            titles[number] if number else "Other claims",
            sorted((row for row in rows if row.chapter == number), key=lambda row: row.place),
        )
        for number in numbers
    ]


def _changes(manifests: Iterable[Manifest]) -> list[tuple[str, str, str, str]]:
    """Settings that differ from the published ones: setting, published value, our value, sweeps."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for manifest in manifests:
        for key, values in manifest.changed.items():
            published, ours = (line(value) or "none" for value in values)
            found.setdefault((key, published, ours), []).append(manifest.name or "")
    return [(*change, joined(names)) for change, names in found.items()]


def _verdicts(claims: Sequence[TestedClaim]) -> str:
    return joined(f"{count} {verdict}" for verdict, _, count in tally(claims))


def _said(sweeps: Sequence[Sweep], of: Callable[[Manifest], str]) -> str:
    """What manifests say; different answers with the sweeps that give them."""
    found: dict[str, list[str]] = {}
    for sweep in sweeps:
        if text := of(sweep.manifest):
            found.setdefault(text, []).append(sweep.name)
    if len(found) == 1:
        return next(iter(found))
    return "; ".join(f"{text} ({joined(names)})" for text, names in found.items())
