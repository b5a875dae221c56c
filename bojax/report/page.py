"""The page: fills the template with the texts, tables and figures of a report."""

from collections.abc import Sequence

from bojax.config.component import Component
from bojax.experiments.settings import Learning, Planning
from bojax.report import statistics, tables
from bojax.report.drawing.base import Drawing
from bojax.report.explanations import AtHand, explanations_of
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.report.template import fill
from bojax.report.text import counted, joined, line, plain, ranged, seconds
from bojax.report.verdicts import TestedClaim, tally


def render(
    results: Results, claims: Sequence[TestedClaim], drawings: Sequence[Drawing], notes: Sequence[str]
) -> str:
    """The whole page, with the entries of `claims.json` and with notes on what is missing.

    The first of the drawings is the reproduced figure.
    """
    counts = [results.runs_of(point)["run"].size for point in results.points]
    most = max(counts)
    groups = f" The bootstrap resamples {statistics.resampled(most)}." if most > statistics.GROUPS else ""
    common, own = tables.settings(results)
    speeds = tables.speeds(results)
    return fill(
        "report.html.j2",
        title=results.manifest.title,
        summary=summary(results),
        counts=tally(claims),
        changed=results.manifest.changes,
        claims=claims,
        explanations=explanations_of(AtHand(results, claims), {}),
        plates=drawings,
        ranked=tables.ranked(results),
        outcomes=tables.outcomes(results),
        ratios=tables.ratios(results),
        has_thesis=bool(results.report.thesis),
        speeds=speeds,
        has_latency=speeds is not None and tables.LATENCY in speeds.headings,
        is_learning=any(point.is_learning for point in results.points),
        methods=statistics.methods(counts),
        resampling=groups,
        common=common,
        own=own,
        notes=[*filter(None, map(str.strip, results.report.notes.split("\n\n"))), *notes],
        provenance=provenance(results),
        footer="Written by bojax from the tables of this folder, which hold every number shown here.",
    )


def summary(results: Results) -> str:
    """One sentence that says what was run."""
    points, manifest = results.points, results.manifest
    nouns, places, lengths = zip(*(_described(point.experiment) for point in points), strict=True)
    noun = nouns[0] if len(set(nouns)) == 1 else "setting"
    labels = {point.label for point in points}
    what = counted(len(points), noun)
    if noun != "setting" and len(labels) < len(points):
        what = f"{counted(len(points), 'setting')} of {counted(len(labels), noun)}"
    if len(points) <= 12:
        what += f" ({joined(point.name for point in points)})"
    for phrase in ("on the problem", "in the environment"):
        if kinds := {kind for place, kind in filter(None, places) if place == phrase}:
            what += f" {phrase} {joined(sorted(kinds))}"
    runs = ranged((results.runs_of(point)["run"].size for point in points), "run")
    each = " each" if len(points) > 1 else ""
    steps = f" of up to {counted(*max(lengths))}" if all(lengths) else ""
    run, build = seconds(manifest.run_seconds), seconds(manifest.compile_seconds)
    time = f", in {run} of run time and {build} of compilation" if manifest.run_seconds else ""
    return f"{what}: {runs}{each}{steps}{time}."


def _described(experiment: Component | Unread) -> tuple[str, tuple[str, str] | None, tuple[int, str] | None]:
    """Noun for a point; phrase and kind of the problem or environment; most steps or episodes of a run."""
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
    rows = {
        "command": manifest.command,
        "written": manifest.written,
        "time taken": f"{run} of run time, {build} of compilation" if manifest.groups else "",
        "runs, seed": f"{plain(manifest.runs)}, {plain(manifest.seed)}",
        **manifest.provenance,
        "compiled": manifest.compiled,
        "hash of settings": line(manifest.config_hash),
    }
    return [(key, value) for key, value in rows.items() if value]
