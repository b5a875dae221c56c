"""Experiment and sweep files: read, override, expand, validate; everything wrong ends in one line."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from bojax.config import catalog as _catalog  # noqa: F401 (registers every schema class)
from bojax.config.axes import Combination, expand, read_axes, split_overrides
from bojax.config.changed import changed_settings
from bojax.config.claims import Claim
from bojax.config.component import Component, Schema, Slot, merged
from bojax.config.errors import ConfigError, Location, dotted, from_validation, one_of, shown
from bojax.config.files import SUFFIXES, display, find, shipped
from bojax.config.limits import RUNS
from bojax.config.origin import Origin
from bojax.config.overrides import Override, apply, parse_overrides
from bojax.config.settings import RESERVED, EngineConfig, Record, Settings, split
from bojax.config.yaml_file import read_mapping

_EXPERIMENT = pydantic.TypeAdapter(Annotated[Component, Slot("experiment")])

DEFAULT_RUNS = 200
"""Runs of a sweep that says nothing: what the thesis's figures are redrawn from."""


@dataclass(frozen=True)
class Point:
    """One setting of a sweep.

    Attributes:
        index: Its number.
        label: The identifier that results use for it: the planner's kind, the learner's kind.
        variant: Its name in the sweep.
        swept: Values of the swept keys, by dotted path; of a named subtree, the name.
        config: The experiment.
    """

    index: int
    label: str
    variant: str
    swept: dict[str, Any]
    config: Component


def _locate_point(index: int, location: Location) -> str:
    return f"point {index}: {dotted(location)}"


@dataclass(frozen=True)
class Sweep:
    """What is to be run, completely validated except for parts given by import path.

    Attributes:
        name: What the user called it; the name of the results folder.
        title: One line for reports.
        points: The settings.
        runs: Runs of every point.
        seed: Seed of all run keys.
        record: Which runs leave arrays.
        engine: How runs are executed.
        report: What the report shows.
        claims: What the thesis says, with tests.
        base: The experiment before the axes, as written and overridden.
        source: The file.
        changed: Settings that differ from the published sweep, as `{dotted path: [published, ours]}`: that
            which bojax brings under the name of this sweep. Empty if there is none.
        locate: Where a setting of a point comes from, as `FILE: dotted.path`, for messages.
    """

    name: str
    title: str
    points: tuple[Point, ...]
    runs: int
    seed: int
    record: Record
    engine: EngineConfig
    report: dict[str, Any]
    claims: tuple[Claim, ...]
    base: dict[str, Any]
    source: Path
    changed: dict[str, list[Any]] = field(default_factory=dict)
    locate: Callable[[int, Location], str] = field(default=_locate_point, repr=False, compare=False)


class Report(Schema, frozen=True):
    """What the report of a sweep shows."""

    figures: tuple[str, ...] = Field(default=(), strict=False, description="figures, in order")
    notes: str = Field(default="", description="a paragraph above the figures")
    thesis: dict[str, Any] = Field(default={}, description="the thesis's numbers, shown beside ours")
    relative_to: str | None = Field(
        default=None, description="variant that ratios to the thesis's numbers are taken to"
    )
    by_step: int | None = Field(default=None, ge=1, description="step at which tables give rates as well")
    best_return: float | None = Field(default=None, description="a line in learning curves")
    rolling: int | None = Field(
        default=None, ge=1, lt=2**31, description="episodes over which learning curves average each run"
    )
    over: str | None = Field(default=None, description="the swept number of growth and sweep-curve")
    column: str | None = Field(default=None, description="the column of runs.parquet that these draw")


class SweepFile(Schema, frozen=True):
    """The keys of a sweep file that are not settings of the base."""

    axes: dict[str, Any] = Field(default={}, description="dotted paths, each with its values")
    combine: Literal["grid", "zip"] = Field(default="grid", description="how axes are combined")
    report: Report = Field(default=Report(), description="what the report shows")
    claims: tuple[Claim, ...] = Field(default=(), strict=False, description="what the thesis says")


def load_sweep(
    source: str, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The sweep of a file in `sweeps/`.

    Args:
        source: A name or a path.
        overrides: Dotted `key=value` texts.
        runs: Overrides `runs`.
        seed: Overrides `seed`.

    Raises:
        ConfigError: Something is wrong; the message is one line.
    """
    given = find(source, "sweeps")
    path, mapping = _follow_alias(given)
    changes = _changes(overrides, runs, seed)
    sweep = _expand(path, mapping, given.stem, source, changes)
    folder = shipped("sweeps").resolve()
    published = path.resolve() if path.resolve().parent == folder else folder / f"{sweep.name}.yaml"
    if not published.is_file() or (published == path.resolve() and not changes):
        return sweep
    published, mapping = _follow_alias(published)
    original = _expand(published, mapping, sweep.name, sweep.name, [])
    return replace(sweep, changed=changed_settings(original, sweep))


def _expand(
    path: Path, mapping: Mapping[str, Any], name: str, source: str, changes: Sequence[Override]
) -> Sweep:
    """The sweep that a file holds, with changes from the command line."""
    file = display(path)
    parsed, own = _read_sweep(mapping, file, source)
    base, locate_base = _read_base(mapping["base"], path)
    settings, experiment = split(base)
    combinations = read_axes(parsed.axes, parsed.combine, file)
    in_base, below_axes = split_overrides(changes, combinations, file)
    settings = merged({"title": name, "runs": DEFAULT_RUNS, **settings}, own)
    settings, experiment = _override(settings, experiment, in_base)
    origin = Origin(
        base=locate_base,
        file=file,
        own=tuple(own),
        overridden=tuple(change.path for change in changes),
        combinations=combinations,
    )
    experiments = expand(experiment, combinations, below_axes, file)
    sweep = _assemble(path, name, settings, experiments, experiment, origin, parsed)
    _check_claims(sweep, file)
    return sweep


def load_config(
    source: str, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The experiment of a file in `configs/`, as a sweep of one point; see `load_sweep`."""
    path = find(source, "configs")
    file = display(path)
    mapping = read_mapping(path, file)
    if {"base", "axes", "alias"} & mapping.keys():
        raise ConfigError(f"{file}: is a sweep, not an experiment; start it by: bojax sweep {source}")
    changes = _changes(overrides, runs, seed)
    settings, experiment = split(mapping)
    saved = experiment.get("saved")
    if isinstance(saved, str) and os.path.exists(path.parent / saved):  # relative to the file that names it
        experiment["saved"] = str(path.parent / saved)
    settings, experiment = _override(settings, experiment, changes)
    origin = Origin(
        base=lambda location: f"{file}: {dotted(location)}",
        file=file,
        own=(),
        overridden=tuple(change.path for change in changes),
        combinations=[()],
    )
    settings = {"title": path.stem, "runs": 1, **settings}
    return _assemble(path, path.stem, settings, [experiment], experiment, origin, SweepFile())


def validate_experiment(settings: Any) -> Component:
    """The experiment that a mapping of settings describes.

    Raises:
        pydantic.ValidationError: A setting is wrong.
    """
    return _EXPERIMENT.validate_python(settings)


def _read_sweep(mapping: Mapping[str, Any], file: str, source: str) -> tuple[SweepFile, dict[str, Any]]:
    """The sweep's own part of a file, and the settings that it shares with experiments."""
    if "base" not in mapping:
        hint = "" if "axes" in mapping else f"; an experiment is started by: bojax run {source}"
        raise ConfigError(
            f"{file}: base: missing; a name in configs/, a file or an experiment is expected{hint}"
        )
    own = {key: value for key, value in mapping.items() if key in RESERVED}
    rest = {key: value for key, value in mapping.items() if key not in (*RESERVED, "base")}
    try:
        return SweepFile.model_validate(rest), own
    except pydantic.ValidationError as error:
        raise from_validation(
            error, lambda location: f"{file}: {dotted(location)}", siblings=(*RESERVED, "base")
        ) from error


def _follow_alias(path: Path) -> tuple[Path, dict[str, Any]]:
    """The file that an alias stands for, with its content."""
    seen = []
    while True:
        file = display(path)
        mapping = read_mapping(path, file)
        if "alias" not in mapping:
            return path, mapping
        target = mapping["alias"]
        if len(mapping) > 1 or not isinstance(target, str):
            raise ConfigError(f"{file}: alias: an alias is the name of another sweep, and stands alone")
        seen.append(path.resolve())
        try:
            path = find(target, "sweeps", beside=[path.parent])
        except ConfigError as error:
            raise ConfigError(f"{file}: alias: {error}") from error
        if path.resolve() in seen:
            raise ConfigError(f"{file}: alias: {target} leads back to itself")


def _read_base(base: Any, sweep: Path) -> tuple[dict[str, Any], Callable[[Location], str]]:
    file = display(sweep)
    if isinstance(base, dict):
        return base, lambda location: f"{file}: {dotted(('base', *location))}"
    if not isinstance(base, str):
        raise ConfigError(f"{file}: base: a name in configs/, a file, or an experiment is expected")
    # A path is relative to the sweep; a name is not, or `base: parking` would find the sweep `parking`.
    beside = sweep.parent if base.endswith(SUFFIXES) else sweep.parent.parent / "configs"
    try:
        path = find(base, "configs", beside=[beside])
    except ConfigError as error:
        raise ConfigError(f"{file}: base: {error}") from error
    name = display(path)
    return read_mapping(path, name), lambda location: f"{name}: {dotted(location)}"


def _changes(texts: Sequence[str], runs: int | None, seed: int | None) -> list[Override]:
    options = {("runs",): runs, ("seed",): seed}
    options = {path: value for path, value in options.items() if value is not None}
    changes = [change for change in parse_overrides(texts) if change.path not in options]
    return changes + [Override(path, value) for path, value in options.items()]


def _override(
    settings: dict[str, Any], experiment: dict[str, Any], changes: Sequence[Override]
) -> tuple[dict[str, Any], dict[str, Any]]:
    for change in changes:
        if change.path == ("experiment",):
            experiment = apply(experiment, Override(("kind",), change.value))
        elif change.path[0] in RESERVED:
            settings = apply(settings, change)
        else:
            experiment = apply(experiment, change)
    return settings, experiment


def _assemble(
    path: Path,
    name: str,
    settings: Mapping[str, Any],
    experiments: Sequence[Mapping[str, Any]],
    base: Mapping[str, Any],
    origin: Origin,
    file: SweepFile,
) -> Sweep:
    """Validate every point and every setting."""
    points = []
    for index, (raw, combination) in enumerate(zip(experiments, origin.combinations, strict=True)):
        locate = partial(origin.point, index)
        try:
            config = validate_experiment(raw)
        except pydantic.ValidationError as error:
            raise from_validation(error, locate, siblings=(*RESERVED, "experiment")) from error
        points.append(_point(index, config, combination))
    try:
        values = Settings.model_validate(settings)
    except pydantic.ValidationError as error:
        raise from_validation(error, origin.setting) from error
    RUNS.check(values.runs * len(points), origin.setting(("runs",)))
    return Sweep(
        name=name,
        title=values.title,
        points=tuple(points),
        runs=values.runs,
        seed=values.seed,
        record=values.record,
        engine=values.engine,
        report=file.report.model_dump(mode="json", exclude_unset=True),
        claims=file.claims,
        base={"experiment": base["kind"]} | {key: value for key, value in base.items() if key != "kind"},
        source=path,
        locate=origin.point,
    )


def _point(index: int, config: Component, combination: Combination) -> Point:
    swept = {
        ".".join(choice.axis): _value_at(config, choice.axis, choice.value)
        if choice.name is None
        else choice.name
        for choice in combination
    }
    variant = "/".join(choice.name for choice in combination if choice.name is not None)
    return Point(index, config.label, variant or config.label, swept, config)


def _value_at(config: Any, path: Sequence[str], written: Any) -> Any:
    """A swept value as its schema typed it (1 on an axis of floats is 1.0), or else as written."""
    for name in path:
        config = getattr(config, name, None)
    return config if isinstance(config, bool | int | float | str) else written


def _check_claims(sweep: Sweep, file: str) -> None:
    """Refuse claims of one id, and claims and ratios of variants that the sweep does not have."""
    variants = {point.variant for point in sweep.points}
    relative_to = sweep.report.get("relative_to")
    if relative_to is not None and relative_to not in variants:
        raise ConfigError(
            f"{file}: report.relative_to: got {shown(relative_to)}; no such variant"
            f"{one_of(relative_to, variants)}"
        )
    seen = set()
    for index, claim in enumerate(sweep.claims):
        where = f"{file}: claims.{index}"
        if claim.id in seen:
            raise ConfigError(f"{where}.id: got {shown(claim.id)}; another claim has this id")
        seen.add(claim.id)
        known = {point.variant if claim.test.by == "variant" else point.label for point in sweep.points}
        for name in claim.test.names:
            if name not in known:
                raise ConfigError(
                    f"{where}.test: got {shown(name)}; no such {claim.test.by}{one_of(name, known)}"
                )
