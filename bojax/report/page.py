"""The page: fills the template with the texts, tables and figures of a report."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from bojax.config.component import Component
from bojax.experiments.settings import Learning, Planning
from bojax.report import statistics, tables
from bojax.report.dark import adapted
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.report.text import MISSING, counted, joined, percent, plain, seconds, with_bounds

VERDICTS = ("reproduced", "not reproduced", "inconclusive")
_MARKS = {"reproduced": "\N{CHECK MARK}", "not reproduced": "\N{MULTIPLICATION SIGN}", "inconclusive": "?"}


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
    environment = Environment(
        loader=PackageLoader("bojax.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["minus"] = _minus
    return environment.get_template("report.html.j2").render(
        title=results.title,
        name=results.name,
        summary=summary(results),
        counts=[
            (verdict, _MARKS[verdict], sum(claim["verdict"] == verdict for claim in claims))
            for verdict in VERDICTS
        ],
        changed=[
            (key, *(_line(value) or "none" for value in values)) for key, values in results.changed.items()
        ],
        claims=[_claim(claim) for claim in claims],
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
    run, build = _times(results)
    time = f", in {seconds(run)} of run time and {seconds(build)} of compilation" if run else ""
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
    rows = [
        ("command", _line(manifest.command)),
        ("written", _line(manifest.written)),
        ("time taken", _time_taken(results)),
        ("runs, seed", f"{plain(manifest.runs)}, {plain(manifest.seed)}"),
        ("revision", _revision(manifest.git)),
        ("device", _line(manifest.device)),
        ("versions", _line(manifest.versions)),
        ("precision", _line(manifest.precision)),
        ("hash of settings", _line(manifest.config_hash)),
    ]
    return [(key, value) for key, value in rows if value]


def _claim(claim: Mapping[str, Any]) -> dict[str, Any]:
    test = claim["test"]
    comparisons = test.get("comparisons") or []
    is_share = test.get("kind") == "share" or test.get("share") is not None
    bounds = _share_bounds if is_share else with_bounds
    ours = claim["ours"]
    if isinstance(ours, float):
        ours = bounds(ours, *claim["interval"])[0]
    listed = [
        (c["of"].replace(" - ", " \N{MINUS SIGN} "), *bounds(c["estimate"], *c["interval"]))
        for c in comparisons
    ]
    # The interval of a single comparison is shown beside our number if it is the interval of that number.
    is_single = len(listed) == 1 and comparisons[0]["estimate"] == claim["ours"]
    return {
        **claim,
        "mark": _MARKS[claim["verdict"]],
        "slug": claim["verdict"].replace(" ", "-"),
        "thesis": "" if claim["thesis"] is None else plain(claim["thesis"]),
        "ours": MISSING if ours is None else ours,
        "interval": listed[0][2] if is_single else "",
        "comparisons": [] if is_single else listed,
        "reason": test.get("reason", ""),
        "method": test.get("method", ""),
        "chosen": [
            f"{label} is represented by {variant}"
            for label, variant in (test.get("chosen") or {}).items()
            if variant != label
        ],
    }


def _resampling(results: Results) -> str:
    """A sentence on what the bootstrap resamples, if not single runs."""
    most = max(results.runs_of(point)["run"].size for point in results.points)
    return f" The bootstrap resamples {statistics.resampled(most)}." if most > statistics.GROUPS else ""


def _share_bounds(estimate: float, low: float, high: float) -> tuple[str, str]:
    return percent(estimate), f"[{percent(low)}, {percent(high)}]"


def _line(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_line(item)}" for key, item in value.items() if item not in (None, ""))
    if isinstance(value, list):
        lines = [_line(item) for item in value]
        kinds = list(dict.fromkeys(lines))
        return ", ".join(f"{lines.count(kind)} x {kind}" if lines.count(kind) > 1 else kind for kind in kinds)
    return "" if value is None else plain(value)


def _revision(git: Mapping[str, Any] | None) -> str:
    if git is None:
        return ""
    return f"{git.get('revision', MISSING)}{', with uncommitted changes' if git.get('has_changes') else ''}"


def _times(results: Results) -> tuple[float, float]:
    """Seconds of run time and of compilation, of all groups."""
    groups = results.manifest.groups
    return sum(group.run_seconds or 0 for group in groups), sum(
        group.compile_seconds or 0 for group in groups
    )


def _time_taken(results: Results) -> str:
    if not results.manifest.groups:
        return ""
    run, build = _times(results)
    return f"{seconds(run)} of run time, {seconds(build)} of compilation"


def _minus(text: Any) -> str:
    """A text in which a hyphen before a digit is a minus sign, as numbers are typeset."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", str(text))
