"""The page: fills the template with the texts, tables and figures of a report."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bojax.config.component import Component
from bojax.experiments.settings import Learning, Planning
from bojax.report import statistics, tables
from bojax.report.dark import adapted
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.report.template import fill
from bojax.report.text import counted, joined, line, plain, seconds
from bojax.report.verdicts import TestedClaim, tally


@dataclass(frozen=True)
class Plate:
    """A figure of the page."""

    name: str
    title: str
    caption: str
    alt: str
    source: str


def plate(name: str, title: str, caption: str, alt: str, svg: bytes) -> Plate:
    """A figure with its SVG as a data URL, so that the page loads no other file."""
    code = base64.b64encode(adapted(svg)).decode("ascii")
    return Plate(name, title, caption, alt, f"data:image/svg+xml;base64,{code}")


def render(
    results: Results, claims: Sequence[Mapping[str, Any]], plates: Sequence[Plate], notes: Sequence[str]
) -> str:
    """The whole page.

    Args:
        results: The results.
        claims: Entries of `claims.json`.
        plates: Figures in the order of the page; the first one is the reproduced figure.
        notes: Remarks of the report on what is missing.
    """
    tested = [TestedClaim.model_validate(claim) for claim in claims]
    return fill(
        "report.html.j2",
        title=results.title,
        name=results.name,
        summary=summary(results),
        counts=tally(tested),
        changed=[
            (key, *(line(value) or "none" for value in values)) for key, values in results.changed.items()
        ],
        claims=tested,
        plates=plates,
        outcomes=tables.outcomes(results),
        ratios=tables.ratios(results),
        has_thesis=bool(results.report.thesis),
        speeds=tables.speeds(results),
        is_learning=any(point.is_learning for point in results.points),
        resampling=_resampling(results),
        common=tables.common_settings(results),
        own=tables.own_settings(results),
        notes=[*filter(None, map(str.strip, results.report.notes.split("\n\n"))), *notes],
        provenance=provenance(results),
        footer="Written by bojax from the tables of this folder, which hold every number shown here.",
    )


def summary(results: Results) -> str:
    """One sentence that says what was run."""
    nouns, places, lengths = zip(*(_described(point.experiment) for point in results.points), strict=True)
    noun = nouns[0] if len(set(nouns)) == 1 else "setting"
    names = [point.name for point in results.points]
    labels = {point.label for point in results.points}
    what = counted(len(names), noun)
    if noun != "setting" and len(labels) < len(names):
        what = f"{counted(len(names), 'setting')} of {counted(len(labels), noun)}"
    listed = f" ({joined(names)})" if len(names) <= 12 else ""
    kinds: dict[str, set[str]] = {}
    for phrase, kind in filter(None, places):
        kinds.setdefault(phrase, set()).add(kind)
    where = "".join(f" {phrase} {joined(sorted(kinds[phrase]))}" for phrase in sorted(kinds, reverse=True))
    numbers = sorted({int(results.runs_of(point)["run"].size) for point in results.points})
    runs = (
        counted(numbers[-1], "run")
        if len(numbers) == 1
        else f"{numbers[0]:,} to {counted(numbers[-1], 'run')}"
    )
    each = " each" if len(names) > 1 else ""
    longest = max((length for length in lengths if length), default=None)
    steps = f" of up to {counted(*longest)}" if longest and all(lengths) else ""
    run, build = seconds(results.manifest.run_seconds), seconds(results.manifest.compile_seconds)
    time = f", in {run} of run time and {build} of compilation" if results.manifest.run_seconds else ""
    return f"{what}{listed}{where}: {runs}{each}{steps}{time}."


def _described(experiment: Component | Unread) -> tuple[str, tuple[str, str] | None, tuple[int, str] | None]:
    """What is compared; where it was run, as phrase and kind; the greatest length of a run, with its unit."""
    if isinstance(experiment, Planning):
        problem = experiment.problem
        steps = getattr(problem, "max_steps", None)
        return "planner", ("on the problem", problem.kind), None if steps is None else (steps, "step")
    if isinstance(experiment, Learning):
        return "learner", ("in the environment", experiment.env.kind), (experiment.episodes, "episode")
    return "setting", None, None


def provenance(results: Results) -> list[tuple[str, str]]:
    """Provenance of the results: command, times, seeds, versions, device."""
    manifest = results.manifest
    run, build = seconds(manifest.run_seconds), seconds(manifest.compile_seconds)
    rows = [
        ("command", line(manifest.command)),
        ("written", line(manifest.written)),
        ("time taken", f"{run} of run time, {build} of compilation" if manifest.groups else ""),
        ("runs, seed", f"{plain(manifest.runs)}, {plain(manifest.seed)}"),
        ("revision", manifest.revision),
        ("device", line(manifest.device)),
        ("versions", line(manifest.versions)),
        ("precision", line(manifest.precision)),
        ("hash of settings", line(manifest.config_hash)),
    ]
    return [(key, value) for key, value in rows if value]


def _resampling(results: Results) -> str:
    """A sentence on what the bootstrap resamples, if not single runs."""
    most = max(results.runs_of(point)["run"].size for point in results.points)
    return f" The bootstrap resamples {statistics.resampled(most)}." if most > statistics.GROUPS else ""
