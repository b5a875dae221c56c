"""Builds a report: writes figures, `claims.json` and `report.html` of a results folder, each atomically."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bojax.config.component import External
from bojax.config.figures import FIGURES, TABLES
from bojax.report import style
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.figures import draw
from bojax.report.findings import evaluate
from bojax.report.manifest import Unread
from bojax.report.page import render
from bojax.report.source import Results, load
from bojax.report.tables import count_nan_runs, ranking_gaps, thesis_gaps
from bojax.report.text import counted, joined
from bojax.report.verdicts import CLAIMS
from bojax.results.store import ResultsError, explained, write_content
from bojax.text import error_line


def build_report(folder: Path, at: Callable[[str], None] = lambda stage: None) -> Path:
    """Write the report of a results folder into it, replacing an earlier report, and return `report.html`.

    Figures, claims and page depend on the tables and the manifest alone, and equal input gives equal files.
    Nothing is written before everything is ready. `at` is called with the name of each stage as it begins.
    """
    at("tables")
    results = load(folder)
    at(f"claims of {counted(results.runs['run'].size, 'run')}")
    claims = evaluate(results)
    drawings, notes = _figures(results, at)
    at("page")
    notes = [*notes, *thesis_gaps(results), *ranking_gaps(results), *_gaps(results), *_unknown(results)]
    page = render(results, claims, list(drawings.values()), notes)

    style.write_images(folder, {name: drawing.files for name, drawing in drawings.items()})
    for name in FIGURES.keys() - drawings:  # an earlier report may have drawn them
        for suffix in ("png", "svg"):
            with explained(path := folder / style.FIGURES / f"{name}.{suffix}"):
                path.unlink(missing_ok=True)
    entries = [claim.model_dump(mode="json", by_alias=True) for claim in claims]
    text = json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_content(folder / CLAIMS, text)
    write_content(folder / "report.html", page)
    return folder / "report.html"


def _figures(results: Results, at: Callable[[str], None]) -> tuple[dict[str, Drawing], list[str]]:
    """The figures of the page by name, and notes on figures that are missing."""
    asked = results.report.figures
    drawings, notes, missing = dict[str, Drawing](), list[str](), list[str]()
    for name in dict.fromkeys(asked or FIGURES):
        if name in TABLES:
            continue
        if name not in FIGURES:
            notes.append(f"No figure is called {name}: the figures are {joined(sorted(FIGURES))}.")
            continue
        at(f"figure {name}")
        try:
            with style.settings() as unwritten:
                drawings[name] = draw(name, results).encoded()
            missing += unwritten
        except FigureUnavailable as reason:
            if asked:
                notes.append(f"The figure {name} is not drawn: {reason}.")
        except ResultsError:
            raise
        except Exception as error:  # a failed figure must not cost the page
            notes.append(f"The figure {name} could not be drawn: {error_line(error)}.")
    if missing:
        notes.append(
            "Figures show some characters of names as boxes, because no font on this machine has them. "
            "Install one that does, such as Noto Sans CJK, and run bojax report again."
        )
    return drawings, notes


def _gaps(results: Results) -> list[str]:
    """Notes on runs that are missing and on values that are not numbers."""
    notes = []
    wanted = results.manifest.runs or 0
    short = [point for point in results.points if results.runs_of(point)["run"].size < wanted]
    if short:
        missing = sum(wanted - results.runs_of(point)["run"].size for point in short)
        errors = dict.fromkeys(chunk.error for chunk in results.manifest.chunks if chunk.error)
        notes.append(
            f"Missing: {counted(missing, 'run')} of {joined(point.name for point in short)}; "
            f"--resume runs them again.{''.join(f' {error}.' for error in errors)}"
        )
    bad = [f"{point.name} {count}" for point in results.points if (count := count_nan_runs(results, point))]
    if bad:
        diverged = int(np.isnan(results.runs.get("planned_return", np.zeros(0))).sum())
        reason = f" In {counted(diverged, 'run')}, what was learned became non-finite." if diverged else ""
        notes.append(f"Runs with a NaN: {', '.join(bad)}.{reason}")
    return notes


def _unknown(results: Results) -> list[str]:
    """Notes on settings that the report could not read."""
    notes = []
    refused = {
        point.name: point.experiment.reason
        for point in results.points
        if isinstance(point.experiment, Unread)
    }
    if refused:
        notes.append(
            f"This version of bojax cannot read the settings of {joined(refused)} "
            f"({joined(dict.fromkeys(refused.values()))}): figures and tables that depend on them are "
            "left out."
        )
    parts = (part for point in results.points for part in (point.experiment, point.problem))
    own = list(dict.fromkeys(part.kind for part in parts if isinstance(part, External)))
    if own:
        notes.append(
            f"{joined(own)}: given by import path, so the report knows the settings only as plain values."
        )
    return notes
