"""Results folders in; figures, `claims.json` and `report.html` out, each written whole or not at all."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bojax.config.component import External
from bojax.report import style
from bojax.report.claims.evaluate import evaluate
from bojax.report.figures import FIGURES
from bojax.report.figures.base import Undrawable
from bojax.report.manifest import Unread
from bojax.report.page import Plate, plate, render
from bojax.report.source import Results, load
from bojax.report.tables import count_nan_runs, thesis_gaps
from bojax.report.text import counted, joined
from bojax.results.store import ResultsError, explained, write_atomically
from bojax.text import error_line

_TABLES = ("latency",)
"""Names that `report.figures` may hold and that are tables of every page."""


def build_report(folders: Sequence[Path], at: Callable[[str], None] = lambda stage: None) -> Path:
    """Write the report of each folder into it, replacing what an earlier report left there.

    Figures, claims and page are derived from the tables alone: equal tables and manifest give equal
    files. Nothing is written before everything is ready.

    Args:
        folders: Results folders.
        at: Called with the name of each stage before it begins.

    Returns:
        The last folder's `report.html`.

    Raises:
        ResultsError: If a folder is missing, unfinished, damaged or cannot be written; one line.
    """
    page = Path()
    for folder in folders:
        page = _build(Path(folder), at)
    return page


def _build(folder: Path, at: Callable[[str], None]) -> Path:
    at("tables")
    results = load(folder)
    at(f"claims of {counted(results.runs['run'].size, 'run')}")
    claims = evaluate(results)
    images, plates, notes = _figures(results, at)
    at("page")
    page = render(
        results, claims, plates, [*notes, *thesis_gaps(results), *_gaps(results), *_unknown(results)]
    )

    figures = folder / "figures"
    with explained(figures):
        figures.mkdir(exist_ok=True)
    for name in FIGURES:
        for suffix in ("png", "svg"):
            path = figures / f"{name}.{suffix}"
            if name in images:
                _write(path, images[name][suffix])
            else:
                with explained(path):
                    path.unlink(missing_ok=True)  # of an earlier report: it would no longer agree
    text = json.dumps(claims, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    _write(folder / "claims.json", text.encode())
    _write(folder / "report.html", page.encode())
    return folder / "report.html"


def _figures(results: Results, at: Callable[[str], None]) -> tuple[dict[str, Any], list[Plate], list[str]]:
    """Files by figure, figures on the page, and why a figure that was asked for is not there."""
    asked = results.report.figures
    names = list(dict.fromkeys(asked or FIGURES))
    images, plates, notes = {}, [], []
    missing: list[str] = []
    for name in names:
        if name in _TABLES:
            continue
        if name not in FIGURES:
            notes.append(f"No figure is called {name}: the figures are {joined(list(FIGURES))}.")
            continue
        at(f"figure {name}")
        try:
            with style.settings() as unwritten:
                drawing = FIGURES[name](results)
                images[name] = style.encode(drawing.figure)
            missing += unwritten
        except Undrawable as reason:
            if asked:
                notes.append(f"The figure {name} is not drawn: {reason}.")
            continue
        except ResultsError:
            raise
        except Exception as error:  # one figure is no reason to lose the page
            notes.append(f"The figure {name} could not be drawn: {error_line(error)}.")
            continue
        plates.append(plate(name, drawing.title, drawing.caption, drawing.alt, images[name]["svg"]))
    if missing:
        notes.append(
            "Some characters of the names stand as boxes in the figures: no font of this machine has them. "
            "With one that does, such as Noto Sans CJK, bojax report draws them."
        )
    return images, plates, notes


def _gaps(results: Results) -> list[str]:
    """What is missing from the results: runs and numbers."""
    notes = []
    wanted = results.manifest.runs or 0
    short = [point for point in results.points if results.runs_of(point)["run"].size < wanted]
    if short:
        missing = sum(wanted - results.runs_of(point)["run"].size for point in short)
        errors = dict.fromkeys(chunk.error for chunk in results.manifest.chunks if chunk.error)
        notes.append(
            f"{counted(missing, 'run')} of {joined([point.name for point in short])} missing; "
            f"--resume tries them again.{''.join(f' {error}.' for error in errors)}"
        )
    bad = [f"{point.name} {count}" for point in results.points if (count := count_nan_runs(results, point))]
    if bad:
        notes.append(f"Runs with a value that is not a number: {', '.join(bad)}.")
    return notes


def _unknown(results: Results) -> list[str]:
    """What the report could not know, since only settings that it can read tell it."""
    notes = []
    refused = {
        point.name: point.experiment.reason
        for point in results.points
        if isinstance(point.experiment, Unread)
    }
    if refused:
        notes.append(
            f"This version of bojax cannot read the settings of {joined(list(refused))} "
            f"({joined(list(dict.fromkeys(refused.values())))}): figures and tables that depend on them are "
            "left out."
        )
    parts = (part for point in results.points for part in (point.experiment, point.problem))
    own = list(dict.fromkeys(part.kind for part in parts if isinstance(part, External)))
    if own:
        notes.append(
            f"{joined(own)}: given by import path, so the report knows the settings only as plain values."
        )
    return notes


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
