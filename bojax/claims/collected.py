"""The newest results of each sweep of bojax in several folders, with claims decided by today's tests.

Results may be older than the claims of their sweep, and than the tests that decide them. They are judged by
the claims, tests and published settings of this version.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pydantic

from bojax.claims.multiverse.outcomes import FILE as MULTIVERSE
from bojax.config import sweep as config
from bojax.config.changed import changed_settings
from bojax.config.claims import Claim, Test
from bojax.config.errors import listed
from bojax.config.sweep_file import published_name
from bojax.report.explanations import AtHand
from bojax.report.findings import cause_of, evaluate
from bojax.report.manifest import ClaimEntry, Unread
from bojax.report.source import Results, load
from bojax.report.verdicts import CLAIMS, TestedClaim, read_claims
from bojax.results.store import MANIFEST, ResultsError, read_json


def collected(folders: Iterable[Path]) -> list[tuple[AtHand, int]]:
    """The newest results of each sweep of bojax, with its claims.

    The folders hold such results, or are above some; other results are ignored. Manifests have the name and
    title of the sweep, and the settings that differ from its own. The number counts verdicts taken from the
    results' own report, because tables are missing.
    """
    newest: dict[str, Results] = {}
    for results in (each for folder in folders for each in _results(folder)):
        name = _name_of(results)
        if name not in newest or results.manifest.written > newest[name].manifest.written:
            newest[name] = results
    return [_judged(results, config.load_published(name)) for name, results in sorted(newest.items())]


def _results(folder: Path) -> list[Results]:
    """The results in a folder, or the finished ones below it, that are of sweeps of bojax."""
    below = [] if (folder / MANIFEST).exists() else sorted(folder.rglob(MANIFEST))
    finished = [path.parent for path in below if read_json(path).get("status") in ("finished", "failed")]
    is_other = not finished and any(folder.rglob(MULTIVERSE))
    loaded = [] if is_other else [load(each) for each in finished or [folder]]
    found = [results for results in loaded if _name_of(results)]
    if not found and not any(folder.rglob(MULTIVERSE)):
        others = listed("", {results.manifest.name for results in loaded})
        raise ResultsError(f"{folder}: got results of {others}; allowed: those of sweeps of bojax")
    return found


def _name_of(results: Results) -> str:
    """Which sweep of bojax results are of, also by an alias; empty for none."""
    return published_name(results.manifest.name) or "" if results.manifest.is_published else ""


def _judged(results: Results, sweep: config.Sweep) -> tuple[AtHand, int]:
    claims = [ClaimEntry.model_validate(claim.model_dump(mode="json")) for claim in sweep.claims]
    now = {"name": sweep.name, "title": sweep.title, "claims": claims, "changed": _changed(results, sweep)}
    results = replace(results, manifest=results.manifest.model_copy(update=now))
    written = read_claims(results.folder) if (results.folder / CLAIMS).is_file() else []
    known, entries, kept = {entry.id: entry for entry in written}, [], 0
    for entry, claim in zip(evaluate(results), sweep.claims, strict=True):
        entry = entry.model_copy(update={"changed": _changed(results, sweep, claim.test)})
        # What cannot be decided from these results, their report may have decided, by the same test.
        found = known.get(claim.id) if entry.test.reason else None
        if found and not found.test.reason and _test_of(found) == claim.test:
            decided = {key: getattr(found, key) for key in ("ours", "interval", "runs", "verdict", "test")}
            entry = entry.model_copy(update=decided)
            entry = entry.model_copy(update={"cause": cause_of(results, entry)})
            kept += 1
        entries.append(entry)
    return AtHand(results, entries), kept


def _test_of(entry: TestedClaim) -> Test | None:
    """The settings of the test of an entry of `claims.json`; None of a test that this version refuses."""
    known = {key: getattr(entry, key) for key in ("id", "source", "claim", "thesis")}
    try:
        return Claim.model_validate({**known, "test": entry.test.settings}).test
    except pydantic.ValidationError:
        return None


def _changed(results: Results, sweep: config.Sweep, test: Test | None = None) -> dict[str, list[Any]]:
    """Settings of the results, or of the points that a test names, that differ from today's sweep."""

    def named(points: Iterable[config.Point]) -> tuple[config.Point, ...]:
        return tuple(point for point in points if test is None or getattr(point, test.by) in test.names)

    points = [
        config.Point(point.index, point.label, point.variant, dict(point.swept), point.experiment)
        for point in results.points
        if not isinstance(point.experiment, Unread)
    ]
    manifest = results.manifest
    if len(points) < len(results.points) or manifest.runs is None or manifest.seed is None:
        return manifest.changed
    ours = replace(sweep, points=named(points), runs=manifest.runs, seed=manifest.seed)
    published = replace(sweep, points=named(sweep.points))
    # Results record what `auto` stood for.
    return {key: pair for key, pair in changed_settings(published, ours).items() if pair[0] != "auto"}
