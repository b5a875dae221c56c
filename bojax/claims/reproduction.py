"""Pages over several results folders: every claim of the thesis with its verdict, and one page a chapter."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from bojax.claims.chapters import Chapter, Origin, Row, Sweep, relative
from bojax.claims.collected import collected
from bojax.claims.multiverse.outcomes import Multiverse, found_below, with_shares
from bojax.report.explanations import AtHand, causes_of
from bojax.report.manifest import Manifest
from bojax.report.source import load
from bojax.report.template import fill
from bojax.report.text import counted, joined
from bojax.report.text import seconds as in_seconds
from bojax.report.verdicts import TestedClaim, claims_among, read_claims, tally, verdicts_in_words
from bojax.results.store import ResultsError, make_folder, write_content
from bojax.text import error_line

PAGE = "reproduction.html"
TEXT = "reproduction.md"


@dataclass(frozen=True)
class Words:
    """What a page says of where its claims come from."""

    title: str
    does: str  # what does or does not print something
    printed: str  # heading of the printed numbers
    column: str  # what they are called in a sentence

    @property
    def note(self) -> str:
        """The paragraph on bounds."""
        return (
            f"Bounds, margins and windows that {self.does} not print are choices of bojax. They follow the "
            f'word "here" in the column of {self.column}; take them as set after a first look at results. '
            "A verdict that rests on one is marked \N{DAGGER}."
        )


THESIS = Words("Reproduction of the thesis", "the thesis does", "thesis", "the thesis")
OTHERS = Words("Reproduction of published results", "publications do", "published", "published numbers")

_HOLDS_IN = " The column `holds in` has the share of a multiverse's configurations that reproduce a claim."

_SENTENCE = "Of N claims ..., N are reproduced, N are not, and N are inconclusive; N of them rest"
_COUNTS = re.compile(
    r"Of\s+\d+(\s+claims.*?)\d+(\s+are\s+reproduced,\s+)\d+(\s+are\s+not,\s+and\s+)\d+"
    r"(\s+are\s+inconclusive;\s+)\d+(?=\s+of\s+them\s+rest)",
    re.DOTALL,
)
"""The sentence on claims of another page."""


def reproduction(folder: Path, sources: Sequence[Path], seconds: float) -> Path:
    """Write `reproduction.html` and `reproduction.md`, which has the same content without links to reports.

    Beside them, the folder `reproduction` has a page for each chapter. The sources are results folders, each
    with the `claims.json` of its report; one that is missing, unfinished or damaged becomes a line of the
    page. `seconds` is the wall time of the command that ran them.
    """
    found, gaps = dict[str, AtHand](), []
    for source in sources:
        try:
            results = load(source)
            found[results.manifest.name] = AtHand(results, read_claims(source))
        except ResultsError as error:
            gaps.append((relative(source, folder), str(error).removeprefix(f"{source}: ")))
    sweeps = [Sweep.of(each, found, folder) for each in found.values()]
    _write([folder / TEXT, folder / PAGE], sweeps, gaps, [("time taken", in_seconds(seconds))])
    return folder / PAGE


def joined_reproduction(
    pages: Sequence[Path], folders: Sequence[Path], names: Sequence[str], counted_in: Sequence[Path] = ()
) -> list[TestedClaim]:
    """Write pages on the newest results of each of some sweeps in several folders, and return their claims.

    The claims and tests are taken from this version, see `bojax.claims.collected`. Results of other sweeps of
    bojax are quoted by explanations. Multiverse analyses in the folders give the share of configurations in
    which each claim holds, and have pages of their own.

    Pages are `.html` or `.md`, and say which of the named sweeps have no results, if most have. Other pages,
    `counted_in`, have a sentence `_SENTENCE`, whose numbers are updated.
    """
    multiverses = found_below(folders)
    found = collected(folders)
    at_hand = {each.results.manifest.name: each for each, _ in found}
    for name, each in at_hand.items():
        at_hand[name] = replace(each, claims=with_shares(each.claims, name, multiverses))
    sweeps = [Sweep.of(each, at_hand, pages[0].parent) for name, each in at_hand.items() if name in names]
    if not sweeps:
        raise ResultsError(f"got results of {joined(at_hand)}; allowed: also those of a sweep of the thesis")
    missing = [name for name in names if name not in at_hand]
    is_partial = len(missing) > len(sweeps)  # a page on a few figures need not name all others
    gaps = [] if is_partial else [(name, "no finished results in these folders") for name in missing]
    entries = [entry for sweep in sweeps for entry in sweep.entries]
    kept = {each.results.manifest.name: number for each, number in found if number}
    kept = {name: number for name, number in kept.items() if name in names}
    whose = f"{len(entries) - sum(kept.values())} decided by the tests of this version"
    if kept:
        whose += f", {sum(kept.values())} as in their reports, for want of tables ({joined(kept)})"
    others = {page: _recounted(page, entries) for page in counted_in}
    _write(pages, sweeps, gaps, [("verdicts", whose)], multiverses)
    for page, text in others.items():
        write_content(page, text)
    return entries


def _recounted(page: Path, entries: Sequence[TestedClaim]) -> str:
    """A page with these numbers in its sentence on claims."""
    try:
        text = page.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ResultsError(f"{page}: cannot be read: {error_line(error)}") from error
    claims = claims_among(entries)
    bounds = sum(claim.own_bound for claim in claims)
    counts = len(claims), *(count for _, _, count in tally(claims)), bounds
    numbers = "Of {}\\g<1>{}\\g<2>{}\\g<3>{}\\g<4>{}".format(*counts)
    text, times = _COUNTS.subn(numbers, text)
    if times != 1:
        raise ResultsError(f"{page}: got {counted(times, 'sentence')} on claims; allowed: one, {_SENTENCE}")
    return text


def _write(
    pages: Sequence[Path],
    sweeps: Sequence[Sweep],
    gaps: Sequence[tuple[str, str]],
    provenance: Sequence[tuple[str, str]],
    multiverses: Sequence[Multiverse] = (),
) -> None:
    """Write pages on sweeps, each in the format of its suffix, with what else is known of the provenance.

    The pages of the chapters and of the multiverses are in a folder that has the name of the page without its
    suffix.
    """
    for sweep in sweeps:
        if sweep.manifest.status == "failed":
            errors = dict.fromkeys(chunk.error for chunk in sweep.manifest.chunks if chunk.error)
            reason = f"some runs are missing: {'; '.join(errors) or 'unknown error'}"
            gaps = [*gaps, (sweep.manifest.name, reason)]
    entries = (Row.of(sweep, entry) for sweep in sweeps for entry in sweep.entries)
    rows = sorted(entries, key=lambda row: row.order)
    chapters = [Chapter.of(*each) for each in groupby(rows, key=lambda row: row.chapter)]
    words = THESIS if any(row.chapter for row in rows) or not rows else OTHERS
    manifests = [sweep.manifest for sweep in sweeps]
    by_time = sorted(sweeps, key=lambda sweep: sweep.manifest.written)
    origins = list(dict.fromkeys(each.origin for each in by_time))
    values = {
        "title": words.title,
        "words": words,
        "summary": _summary(sweeps, gaps, words),
        "note": words.note + (_HOLDS_IN if any(row.claim.robustness for row in rows) else ""),
        "counts": tally(row.claim for row in rows),
        "gaps": gaps,
        "chapters": chapters,
        "multiverses": multiverses,
        "changes": _changes(manifests),
        "sweeps": sweeps,
        "origins": origins,
        "seconds": in_seconds,
        "compile_seconds": sum(manifest.compile_seconds for manifest in manifests),
        "run_seconds": sum(manifest.run_seconds for manifest in manifests),
        "provenance": [pair for pair in [*_provenance(sweeps, origins), *provenance] if pair[1]],
        "footer": "Written by bojax from the results folders, whose reports have the figures.",
    }
    for page in pages:
        folder, suffix = page.with_suffix(""), page.suffix
        texts = {page: fill(f"reproduction{suffix}.j2", **values, folder=folder.name)}
        for chapter in chapters:
            texts[folder / f"{chapter.file}{suffix}"] = fill(
                f"chapter{suffix}.j2",
                title=chapter.title,
                summary=f"{chapter.verdicts}.",
                counts=tally(row.claim for row in chapter.rows),
                chapter=chapter,
                main=f"../{page.name}",
                words=words,
                provenance=[],
                footer=values["footer"],
            )
        for path, text in texts.items():
            make_folder(path.parent)
            write_content(path, text)
        for each in multiverses:
            from bojax.claims.multiverse.page import write_page  # loads matplotlib, for pages that need it

            write_page(each, folder / f"multiverse-{each.name}{suffix}")


def _summary(sweeps: Sequence[Sweep], gaps: Sequence[tuple[str, str]], words: Words) -> str:
    entries = [entry for sweep in sweeps for entry in sweep.entries]
    claims = claims_among(entries)
    bounds = sum(claim.own_bound for claim in claims)
    others, changed = len(entries) - len(claims), sum(bool(claim.changed) for claim in claims)
    were = "was" if changed == 1 else "were"
    sentences = [
        f"{counted(len(claims), 'claim')}, tested by {counted(len(sweeps), 'sweep')}: "
        f"{verdicts_in_words(claims)}; {bounds} of them rest on a bound that {words.does} not print.",
        causes_of(each for sweep in sweeps for each in sweep.explanations),
        f"Variants and checks, {others} in all, are shown beside them and not counted." if others else "",
        f"{counted(changed, 'claim')} {were} tested with changed settings." if changed else "",
        f"Incomplete or left out: {counted(len(gaps), 'sweep')}." if gaps else "",
    ]
    return " ".join(filter(None, sentences))


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
