"""The page: everything a report says, put into the template as text that is already written."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from bojax.report import statistics, tables
from bojax.report.dark import adapted
from bojax.report.source import Results
from bojax.report.text import MISSING, counted, joined, percent, plain, seconds, with_bounds

VERDICTS = ("reproduced", "not reproduced", "inconclusive")
_MARKS = {"reproduced": "\N{CHECK MARK}", "not reproduced": "\N{MULTIPLICATION SIGN}", "inconclusive": "?"}


@dataclass(frozen=True)
class Plate:
    """A figure as it stands on the page."""

    name: str
    title: str
    caption: str
    alt: str
    source: str


def plate(name: str, title: str, caption: str, alt: str, svg: bytes) -> Plate:
    """A figure with its SVG inline as a data address: nothing is loaded from elsewhere."""
    code = base64.b64encode(adapted(svg)).decode("ascii")
    return Plate(name, title, caption, alt, f"data:image/svg+xml;base64,{code}")


def render(
    results: Results, claims: Sequence[Mapping[str, Any]], plates: Sequence[Plate], notes: Sequence[str]
) -> str:
    """The whole page.

    Args:
        results: What the tables and the provenance are read from.
        claims: Entries of `claims.json`.
        plates: Figures in the order of the page; the first one is the redrawn figure.
        notes: What the report itself has to say about what it left out.
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
        has_thesis=bool(results.settings.get("thesis")),
        speeds=tables.speeds(results),
        is_learning=any(point.is_learning for point in results.points),
        resampling=_resampling(results),
        common=tables.common_settings(results),
        own=tables.own_settings(results),
        notes=[*_paragraphs(results.settings.get("notes")), *notes],
        provenance=provenance(results),
    )


def summary(results: Results) -> str:
    """What was run, in one sentence."""
    configs = [point.config for point in results.points]
    noun = next(
        (noun for noun in ("planner", "learner") if all(noun in config for config in configs)), "setting"
    )
    names = [point.name for point in results.points]
    labels = {point.label for point in results.points}
    what = counted(len(names), noun)
    if noun != "setting" and len(labels) < len(names):
        what = f"{counted(len(names), 'setting')} of {counted(len(labels), noun)}"
    listed = f" ({joined(names)})" if len(names) <= 12 else ""
    where = ""
    for role, phrase in (("problem", "on the problem"), ("env", "in the environment")):
        kinds = sorted({_kind(config.get(role)) for config in configs} - {""})
        where += f" {phrase} {joined(kinds)}" if kinds else ""
    numbers = sorted({int(results.runs_of(point)["run"].size) for point in results.points})
    runs = (
        counted(numbers[-1], "run")
        if len(numbers) == 1
        else f"{numbers[0]:,} to {counted(numbers[-1], 'run')}"
    )
    each = " each" if len(names) > 1 else ""
    length = _most(configs, ("episodes",), "episode") or _most(configs, ("problem", "max_steps"), "step")
    steps = f" of up to {length}" if length else ""
    groups = results.manifest.get("groups") or []
    run = sum(group.get("run_seconds") or 0 for group in groups)
    build = sum(group.get("compile_seconds") or 0 for group in groups)
    time = f", in {seconds(run)} of run time and {seconds(build)} of compilation" if run else ""
    return f"{what}{listed}{where}: {runs}{each}{steps}{time}."


def _most(configs: Sequence[Mapping[str, Any]], path: Sequence[str], noun: str) -> str:
    """The largest number of that setting, with its noun; empty where some point does not have it."""
    found: list[Any] = list(configs)
    for key in path:
        found = [value.get(key) if isinstance(value, Mapping) else None for value in found]
    return counted(max(found), noun) if all(isinstance(value, int) for value in found) else ""


def provenance(results: Results) -> list[tuple[str, str]]:
    """How the results came about: command, times, seeds, versions, machine."""
    manifest = results.manifest
    rows = [
        ("command", _line(manifest.get("command"))),
        ("written", _line(manifest.get("written"))),
        ("time taken", _time_taken(manifest.get("groups") or [])),
        ("runs, seed", f"{plain(manifest.get('runs'))}, {plain(manifest.get('seed'))}"),
        ("revision", _revision(manifest.get("git"))),
        ("device", _line(manifest.get("device"))),
        ("versions", _line(manifest.get("versions"))),
        ("precision", _line(manifest.get("precision"))),
        ("hash of settings", _line(manifest.get("config_hash"))),
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
    # One comparison is written beside our number if it is of that number, not of a difference.
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
            f"{variant} stands for {label}"
            for label, variant in (test.get("chosen") or {}).items()
            if variant != label
        ],
    }


def _resampling(results: Results) -> str:
    """What the bootstrap resamples, where that is not every run by itself."""
    most = max(results.runs_of(point)["run"].size for point in results.points)
    return f" The bootstrap resamples {statistics.resampled(most)}." if most > statistics.GROUPS else ""


def _share_bounds(estimate: float, low: float, high: float) -> tuple[str, str]:
    return percent(estimate), f"[{percent(low)}, {percent(high)}]"


def _paragraphs(notes: Any) -> list[str]:
    if not notes:
        return []
    parts = notes if isinstance(notes, list) else str(notes).split("\n\n")
    return [str(part).strip() for part in parts if str(part).strip()]


def _line(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_line(item)}" for key, item in value.items() if item not in (None, ""))
    if isinstance(value, list):
        lines = [_line(item) for item in value]
        kinds = list(dict.fromkeys(lines))
        return ", ".join(f"{lines.count(kind)} x {kind}" if lines.count(kind) > 1 else kind for kind in kinds)
    return "" if value is None else plain(value)


def _revision(git: Any) -> str:
    if not isinstance(git, Mapping):
        return _line(git)
    return f"{git.get('revision', MISSING)}{', with uncommitted changes' if git.get('has_changes') else ''}"


def _time_taken(groups: Sequence[Mapping[str, Any]]) -> str:
    if not groups:
        return ""
    run, build = (sum(group.get(key) or 0 for group in groups) for key in ("run_seconds", "compile_seconds"))
    return f"{seconds(run)} of run time, {seconds(build)} of compilation"


def _kind(component: Any) -> str:
    if isinstance(component, Mapping):
        return str(component.get("kind", ""))
    return component if isinstance(component, str) else ""


def _minus(text: Any) -> str:
    """A hyphen before a digit as a minus sign, for numbers that are read and not parsed."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", str(text))
