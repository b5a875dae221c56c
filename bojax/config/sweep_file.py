"""Sweep and experiment files as they are written: their keys, aliases, and the base of a sweep."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import pydantic
from pydantic import Field

from bojax.config.catalog import kinds, roles
from bojax.config.claims import Claim, Explanation
from bojax.config.component import Schema
from bojax.config.errors import MAX_NAMES, ConfigError, Location, dotted, from_validation, listed, shown
from bojax.config.files import STANDARD_INPUT, SUFFIXES, available, display, find, shipped
from bojax.config.settings import RESERVED
from bojax.config.thesis import groups
from bojax.config.yaml_file import read_mapping

_ALLOWED_BASE = "allowed: a name in configs/, a YAML file or a mapping"
_ONLY_SWEEPS = {"base", "axes", "alias"}
"""Keys by which the file of a sweep is told from that of an experiment."""


class Report(Schema, frozen=True):
    """Content of the report of a sweep."""

    figures: tuple[str, ...] = Field(default=(), strict=False, description="figures, in order")
    notes: str = Field(default="", description="paragraph above the figures")
    thesis: dict[str, Any] = Field(default={}, description="numbers of the thesis, shown beside the results")
    relative_to: str | None = Field(
        default=None,
        description="variant relative to which results and numbers of the thesis are shown as ratios",
    )
    by_step: int | None = Field(
        default=None, ge=1, description="step at which tables also give the success rate"
    )
    best_return: float | None = Field(default=None, description="return drawn as a line in learning curves")
    rolling: int | None = Field(
        default=None,
        ge=1,
        lt=2**31,
        description="number of episodes over which learning curves average each run",
    )
    over: str | None = Field(default=None, description="swept number on the x axis of growth and sweep-curve")
    column: str | None = Field(
        default=None, description="column of runs.parquet that growth and sweep-curve draw"
    )
    lines: dict[str, float] = Field(
        default={}, description="horizontal lines of sweep-curve, such as published results, by name"
    )
    rank_by: str | None = Field(
        default=None,
        description="column of runs.parquet by which points are ranked, with a minus sign if less is better",
    )
    heat_map: tuple[str, str] | None = Field(
        default=None, strict=False, description="the two swept numbers of heat-map"
    )
    explanations: tuple[Explanation, ...] = Field(
        default=(), strict=False, description="why claims are not reproduced or inconclusive"
    )


class SweepFile(Schema, frozen=True):
    """The keys that only sweep files have."""

    axes: dict[str, Any] = Field(default={}, description="values of each swept key, by dotted path")
    combine: Literal["grid", "zip"] = Field(
        default="grid",
        description="whether points are all combinations of the values, or the values at equal positions",
    )
    report: Report = Field(default=Report(), description="content of the report")
    claims: tuple[Claim, ...] = Field(
        default=(), strict=False, description="claims of the thesis, with their tests"
    )


Source: TypeAlias = str | Mapping[str, Any]
"""Where an experiment or a sweep is described: a name, a path, or the content of a file."""

UNNAMED = Path("config.yaml")
"""Stands in messages, and in the names of results, for the file of a mapping."""


@dataclass(frozen=True)
class Written:
    """A file as it is written."""

    path: Path  # the file, at the end of a chain of aliases
    name: str  # name of the sweep or of the experiment
    base: Mapping[str, Any]  # the experiment file, with its reserved keys
    locate: Callable[[Location], str]  # formats a location in the base as `FILE: dotted.path`
    own: Mapping[str, Any]  # reserved keys that a sweep sets beside its base
    content: SweepFile  # keys that only sweeps have

    @property
    def file(self) -> str:
        """Name of the file in messages."""
        return display(self.path)


def read_config(source: Source) -> Written:
    """An experiment file."""
    path = _find(source, "configs") if isinstance(source, str) else UNNAMED
    file = display(path)
    mapping = _read_experiment(path, file) if isinstance(source, str) else source
    if _ONLY_SWEEPS & mapping.keys():
        raise ConfigError(
            f"{file}: is a sweep, not an experiment; start it with: bojax sweep {_command(source)}"
        )
    return Written(path, path.stem, mapping, lambda location: f"{file}: {dotted(location)}", {}, SweepFile())


def _read_experiment(path: Path, file: str) -> dict[str, Any]:
    """The content of an experiment file, whose saved learner may be given relative to it."""
    mapping = read_mapping(path, file)
    saved = mapping.get("saved")
    if isinstance(saved, str) and os.path.exists(path.parent / saved):
        mapping = {**mapping, "saved": str(path.parent / saved)}
    return mapping


def read_sweep(source: Source) -> Written:
    """A sweep file."""
    given = _find(source, "sweeps") if isinstance(source, str) else UNNAMED
    path, mapping = follow_alias(given) if isinstance(source, str) else (given, source)
    file = display(path)
    if "base" not in mapping:
        hint = "" if "axes" in mapping else f"; start an experiment with: bojax run {_command(source)}"
        raise ConfigError(f"{file}: base: missing; {_ALLOWED_BASE}{hint}")
    rest = {key: value for key, value in mapping.items() if key not in (*RESERVED, "base")}
    try:
        content = SweepFile.model_validate(rest)
    except pydantic.ValidationError as error:
        raise from_validation(
            error, lambda location: f"{file}: {dotted(location)}", siblings=(*RESERVED, "base")
        ) from error
    base, locate = _read_base(mapping["base"], path)
    own = {key: value for key, value in mapping.items() if key in RESERVED}
    return Written(path, given.stem, base, locate, own, content)


def _find(source: str, folder: str) -> Path:
    """The file of a name or path; the name of a figure with several sweeps is refused with a hint."""
    try:
        return find(source, folder)
    except ConfigError:
        if source not in (meant := groups()):
            _check_part(source, folder)
            raise
        names = listed(source, meant[source]) if len(meant[source]) <= MAX_NAMES else "many sweeps"
        raise ConfigError(f"{source}: stands for {names}; start with: bojax reproduce {source}") from None


def _check_part(name: str, folder: str) -> None:
    """Refuse the name of a part with a hint: it is a value of a setting."""
    if any(name in available(each) for each in ("configs", "sweeps")):
        return  # the message that it is in the other folder says more
    role = next((role for role in roles() if name in kinds(role)), None)
    if role is not None:
        is_top = role in ("env", "learner", "planner", "problem", "schedule")
        use = f"choose it by {role}={name}; " if is_top else ""
        raise ConfigError(
            f"{name}: is a part (role {role}), not a name in {folder}/; {use}bojax list {name} shows more"
        )


def _command(source: Source) -> str:
    """A source as a word of the command line; a mapping is read from standard input."""
    return source if isinstance(source, str) else STANDARD_INPUT


def follow_alias(path: Path) -> tuple[Path, dict[str, Any]]:
    """The file that a chain of aliases ends at, and its content."""
    seen = []
    while True:
        file = display(path)
        mapping = read_mapping(path, file)
        if "alias" not in mapping:
            return path, mapping
        target = mapping["alias"]
        if len(mapping) > 1 or not isinstance(target, str):
            raise ConfigError(
                f"{file}: alias: got {shown(target)}; allowed: the name of another sweep, as the only key"
            )
        seen.append(path.resolve())
        try:
            path = find(target, "sweeps", beside=[path.parent])
        except ConfigError as error:
            raise ConfigError(f"{file}: alias: {error}") from error
        if path.resolve() in seen:
            raise ConfigError(f"{file}: alias: got {shown(target)}; aliases must not form a cycle")


def _read_base(base: Any, sweep: Path) -> tuple[dict[str, Any], Callable[[Location], str]]:
    file = display(sweep)
    if isinstance(base, dict):
        return base, lambda location: f"{file}: {dotted(('base', *location))}"
    if not isinstance(base, str):
        raise ConfigError(f"{file}: base: got {shown(base)}; {_ALLOWED_BASE}")
    # A path is relative to the sweep, a name is not: `base: parking` must not find the sweep `parking`.
    beside = sweep.parent if base.endswith(SUFFIXES) else sweep.parent.parent / "configs"
    try:
        path = find(base, "configs", beside=[beside])
    except ConfigError as error:
        raise ConfigError(f"{file}: base: {error}") from error
    name = display(path)
    mapping = _read_experiment(path, name)
    if _ONLY_SWEEPS & mapping.keys():
        raise ConfigError(f"{file}: base: {name} is a sweep; allowed: an experiment")
    return mapping, lambda location: f"{name}: {dotted(location)}"


def published_name(name: str) -> str | None:
    """The name of the sweep of bojax that a name or alias stands for; None if there is none."""
    path = shipped("sweeps") / f"{name}.yaml"
    return follow_alias(path)[0].stem if path in shipped("sweeps").glob("*.yaml") else None


def published_report(name: str) -> Report | None:
    """The settings of the report of a sweep that is part of bojax; None if none has this name."""
    if published_name(name) is None:
        return None
    return Report.model_validate(follow_alias(shipped("sweeps") / f"{name}.yaml")[1].get("report", {}))
