"""The newest results of each sweep of bojax in several folders, with claims decided by today's tests.

Results may be older than the claims of their sweep, and than the tests that decide them. They are judged by
the claims, tests and published settings of this version.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bojax.config import sweep as config
from bojax.config.changed import changed_settings
from bojax.config.claims import Claim
from bojax.config.errors import listed
from bojax.report.claims.evaluate import evaluate
from bojax.report.manifest import ClaimEntry, Manifest, Unread, claims_of, validated
from bojax.report.source import Results, load
from bojax.report.verdicts import CLAIMS, TestedClaim
from bojax.results.store import MANIFEST, ResultsError, read_json

_FOUND = ("method", "comparisons", "chosen", "reason")  # keys of a test in `claims.json` that are no settings


@dataclass(frozen=True)
class Collected:
    """The results of a sweep."""

    folder: Path
    manifest: Manifest  # with the name and title of the sweep, and the settings that differ from its own
    claims: Sequence[TestedClaim]
    kept: int  # how many verdicts are those of its report, because tables are missing


def collected(folders: Iterable[Path], names: Collection[str]) -> list[Collected]:
    """The newest results of each of some sweeps of bojax, by name.

    Args:
        folders: Results folders of these sweeps, or folders above results, of which others are passed over.
        names: The names of the sweeps.
    """
    newest: dict[str, Results] = {}
    for results in (each for folder in folders for each in _results(folder, names)):
        name = _name_of(results, names)
        if name not in newest or results.manifest.written > newest[name].manifest.written:
            newest[name] = results
    return [_judged(results, config.load_published(name)) for name, results in sorted(newest.items())]


def _results(folder: Path, names: Collection[str]) -> list[Results]:
    """The results in a folder, or the finished ones below it that are of these sweeps."""
    below = [] if (folder / MANIFEST).exists() else sorted(folder.rglob(MANIFEST))
    finished = [path.parent for path in below if read_json(path).get("status") in ("finished", "failed")]
    loaded = [load(each) for each in finished or [folder]]
    found = [results for results in loaded if _name_of(results, names)]
    if not found:
        others = listed("", {results.manifest.name for results in loaded})
        raise ResultsError(f"{folder}: got results of {others}; allowed: those of sweeps of the thesis")
    return found


def _name_of(results: Results, names: Collection[str]) -> str:
    """Which of these sweeps results are of, also by an alias; empty for none."""
    name = config.published_name(results.manifest.name) if results.manifest.is_published else None
    return name if name and name in names else ""


def _judged(results: Results, sweep: config.Sweep) -> Collected:
    claims = [ClaimEntry.model_validate(claim.model_dump(mode="json")) for claim in sweep.claims]
    now = {"name": sweep.name, "title": sweep.title, "claims": claims, "changed": _changed(results, sweep)}
    results = replace(results, manifest=results.manifest.model_copy(update=now))
    entries, known = evaluate(results), _recorded(results)
    kept = [_is_kept(entry, claim, known) for entry, claim in zip(entries, sweep.claims, strict=True)]
    for entry, is_kept in zip(entries, kept, strict=True):
        if is_kept:
            found = known[entry["id"]][0]
            entry |= {key: found[key] for key in ("ours", "interval", "runs", "verdict", "test")}
    tested = validated(list[TestedClaim], entries, str(results.folder / CLAIMS))
    return Collected(results.folder, results.manifest, tested, sum(kept))


def _is_kept(entry: dict[str, Any], claim: Claim, known: dict[str, tuple[dict[str, Any], Any]]) -> bool:
    """Whether a claim cannot be decided from these results, but their report has, by the same test."""
    if "reason" not in entry["test"] or claim.id not in known:
        return False
    found, test = known[claim.id]
    return "reason" not in found["test"] and test == claim.test


def _recorded(results: Results) -> dict[str, tuple[dict[str, Any], Any]]:
    """The entries of the report of the results, each with the settings of its test, by id."""
    path = results.folder / CLAIMS
    entries = read_json(path) if path.is_file() else []
    validated(list[TestedClaim], entries, str(path))
    written = [
        ClaimEntry.model_validate(
            {key: entry[key] for key in ("id", "source", "claim", "thesis")}
            | {"test": {key: value for key, value in entry["test"].items() if key not in _FOUND}}
        )
        for entry in entries
    ]
    claims = claims_of(results.manifest.model_copy(update={"claims": written}))
    return {
        entry["id"]: (entry, getattr(claim, "test", None))
        for entry, claim in zip(entries, claims, strict=True)
    }


def _changed(results: Results, sweep: config.Sweep) -> dict[str, list[Any]]:
    """The settings in which the results differ from the sweep as it is now."""
    points = [
        config.Point(point.index, point.label, point.variant, dict(point.swept), point.experiment)
        for point in results.points
        if not isinstance(point.experiment, Unread)
    ]
    manifest = results.manifest
    if len(points) < len(results.points) or manifest.runs is None or manifest.seed is None:
        return manifest.changed
    ours = replace(sweep, points=tuple(points), runs=manifest.runs, seed=manifest.seed)
    # Results record what `auto` stood for.
    return {key: pair for key, pair in changed_settings(sweep, ours).items() if pair[0] != "auto"}
