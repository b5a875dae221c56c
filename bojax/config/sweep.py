"""Experiment and sweep files: reading, overriding, expanding into points and validating."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import pydantic
from pydantic import Field

from bojax.config import catalog as _catalog  # noqa: F401 (registers every schema class)
from bojax.config.axes import Combination, expand, read_axes, split_overrides
from bojax.config.changed import changed_settings
from bojax.config.claims import Claim, Explanation, Window
from bojax.config.component import RECORDED, Component, Schema, Slot, merged
from bojax.config.errors import (
    MAX_NAMES,
    ConfigError,
    Location,
    allowed_names,
    did_you_mean,
    dotted,
    from_validation,
    listed,
    shown,
)
from bojax.config.figures import TABLES, figure_modules
from bojax.config.files import STANDARD_INPUT, SUFFIXES, available, display, find, shipped
from bojax.config.limits import RUNS, check_counts
from bojax.config.origin import Origin
from bojax.config.overrides import SOURCE, Override, apply, parse_overrides
from bojax.config.settings import RESERVED, EngineConfig, Record, Settings, split
from bojax.config.thesis import groups
from bojax.config.yaml_file import read_mapping

_EXPERIMENT = pydantic.TypeAdapter(Annotated[Component, Slot("experiment")])

DEFAULT_RUNS = 200
"""Default of `runs` in a sweep: enough for the figures of the thesis."""

_ALLOWED_BASE = "allowed: a name in configs/, a YAML file or a mapping"


@dataclass(frozen=True)
class Point:
    """One point of a sweep: an experiment with a value of each swept key.

    Attributes:
        index: Number of the point, from 0.
        label: Identifier of the point in results: the kind of its planner or learner.
        variant: Name of the point in the sweep.
        swept: Values of the swept keys, by dotted path; for a named subtree, the name.
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
    """A sweep, validated except for the parts given by import path.

    Attributes:
        name: Name of the sweep and of its results folder.
        title: Title in reports, one line.
        points: The points.
        runs: Number of runs of each point.
        seed: Seed of all run keys.
        record: Which runs are recorded.
        engine: How runs are executed.
        report: Content of the report.
        claims: Claims of the thesis, with their tests.
        base: The experiment before the axes are applied, as written and overridden.
        source: The file.
        changed: Settings that differ from the published sweep of the same name, as
            `{dotted path: [published, ours]}`; empty if there is no published sweep.
        locate: Formats the origin of a setting of a point as `FILE: dotted.path`, for messages.
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

    @property
    def is_published(self) -> bool:
        """Whether its file is part of bojax."""
        return self.source.resolve().parent == shipped("sweeps").resolve()


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


def load_sweep(
    source: Source, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The sweep of a file in `sweeps/`.

    Args:
        source: A name, a path, or the content of such a file.
        overrides: Dotted `key=value` texts.
        runs: Overrides `runs`.
        seed: Overrides `seed`.

    Raises:
        ConfigError: The file or an override is invalid.
    """
    if isinstance(source, str):
        given = _find(source, "sweeps")
        path, mapping = _follow_alias(given)
    else:
        given = path = UNNAMED
        mapping = source
    changes = _changes(overrides, runs, seed)
    sweep = _expand(path, mapping, given.stem, source, changes)
    folder = shipped("sweeps").resolve()
    published = path.resolve() if path.resolve().parent == folder else folder / f"{sweep.name}.yaml"
    if not published.is_file() or (published == path.resolve() and not changes):
        return sweep
    published, mapping = _follow_alias(published)
    original = _expand(published, mapping, sweep.name, sweep.name, [])
    return replace(sweep, changed=changed_settings(original, sweep))


def _find(source: str, folder: str) -> Path:
    """The file of a name or path; the name of a figure with several sweeps is refused with a hint."""
    try:
        return find(source, folder)
    except ConfigError:
        if source not in (meant := groups()):
            raise
        names = listed(source, meant[source]) if len(meant[source]) <= MAX_NAMES else "many sweeps"
        raise ConfigError(f"{source}: stands for {names}; start with: bojax reproduce {source}") from None


def _expand(
    path: Path, mapping: Mapping[str, Any], name: str, source: Source, changes: Sequence[Override]
) -> Sweep:
    """The sweep of a file, with changes from the command line."""
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
    source: Source, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The experiment of a file in `configs/`, as a sweep of one point; see `load_sweep`."""
    path = _find(source, "configs") if isinstance(source, str) else UNNAMED
    file = display(path)
    mapping = read_mapping(path, file) if isinstance(source, str) else source
    if {"base", "axes", "alias"} & mapping.keys():
        raise ConfigError(
            f"{file}: is a sweep, not an experiment; start it with: bojax sweep {_command(source)}"
        )
    changes = _changes(overrides, runs, seed)
    settings, experiment = split(mapping)
    saved = experiment.get("saved")
    if isinstance(saved, str) and os.path.exists(path.parent / saved):  # relative to the config file
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


def published_name(name: str) -> str | None:
    """The name of the sweep of bojax that a name or alias stands for; None if there is none.

    Raises:
        ConfigError: The file is not readable.
    """
    path = shipped("sweeps") / f"{name}.yaml"
    return _follow_alias(path)[0].stem if path in shipped("sweeps").glob("*.yaml") else None


def load_published(name: str) -> Sweep:
    """A sweep of bojax by name, whatever files the working directory has.

    Raises:
        ConfigError: The file is not readable.
    """
    return load_sweep(str(shipped("sweeps") / f"{name}.yaml"))


def published_report(name: str) -> Report | None:
    """The settings of the report of a sweep that is part of bojax; None if none has this name.

    Raises:
        ConfigError: The file is not readable.
    """
    if published_name(name) is None:
        return None
    return Report.model_validate(_follow_alias(shipped("sweeps") / f"{name}.yaml")[1].get("report", {}))


def validate_experiment(settings: Any, *, is_recorded: bool = False) -> Component:
    """The experiment that a mapping of settings describes.

    Args:
        settings: The mapping.
        is_recorded: Whether results record these settings, so that the files of data which they name, with
            the hash of their content, are not read again.

    Raises:
        pydantic.ValidationError: A setting is wrong.
    """
    return _EXPERIMENT.validate_python(settings, context=RECORDED if is_recorded else None)


def _command(source: Source) -> str:
    """A source as a word of the command line; a mapping is read from standard input."""
    return source if isinstance(source, str) else STANDARD_INPUT


def _read_sweep(mapping: Mapping[str, Any], file: str, source: Source) -> tuple[SweepFile, dict[str, Any]]:
    """The keys of a file that only sweeps have, and those shared with experiment files."""
    if "base" not in mapping:
        hint = "" if "axes" in mapping else f"; start an experiment with: bojax run {_command(source)}"
        raise ConfigError(f"{file}: base: missing; {_ALLOWED_BASE}{hint}")
    own = {key: value for key, value in mapping.items() if key in RESERVED}
    rest = {key: value for key, value in mapping.items() if key not in (*RESERVED, "base")}
    try:
        return SweepFile.model_validate(rest), own
    except pydantic.ValidationError as error:
        raise from_validation(
            error, lambda location: f"{file}: {dotted(location)}", siblings=(*RESERVED, "base")
        ) from error


def _follow_alias(path: Path) -> tuple[Path, dict[str, Any]]:
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
    return read_mapping(path, name), lambda location: f"{name}: {dotted(location)}"


def _changes(texts: Sequence[str], runs: int | None, seed: int | None) -> list[Override]:
    changes = parse_overrides(texts)
    given = {change.path: change.value for change in changes}
    for name, value in (("runs", runs), ("seed", seed)):
        if value is None:
            continue
        if (name,) in given:
            both = f"as {name}={shown(given[name,])} and as --{name} {value}"
            raise ConfigError(f"{SOURCE}: {name}: given twice, {both}")
        changes.append(Override((name,), value))
    return changes


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
    """The sweep, with every point and every setting validated."""
    points = []
    for index, (raw, combination) in enumerate(zip(experiments, origin.combinations, strict=True)):
        locate = partial(origin.point, index)
        try:
            config = validate_experiment(raw)
        except pydantic.ValidationError as error:
            raise from_validation(error, locate, siblings=(*RESERVED, "experiment")) from error
        check_counts(config, locate)
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
        dotted(choice.axis): _value_at(config, choice.axis, choice.value)
        if choice.name is None
        else choice.name
        for choice in combination
    }
    variant = "/".join(choice.name for choice in combination if choice.name is not None)
    return Point(index, config.label, variant or config.label, swept, config)


def _value_at(config: Any, path: Sequence[str], written: Any) -> Any:
    """A swept value as typed by its schema, where 1 can be the float 1.0, or else as written."""
    for name in path:
        config = getattr(config, name, None)
    return config if isinstance(config, bool | int | float | str) else written


def _check_column(sweep: Sweep, column: str | None, where: str) -> None:
    """Refuse the column `return` of the runs of learners, which have one return for each episode."""
    is_learning = any(point.config.kind == "learning" for point in sweep.points)
    if is_learning and column is not None and column.removeprefix("-") == "return":
        renamed = column.replace("return", "last_return")
        raise ConfigError(
            f"{where}: got {shown(column)}; did you mean {shown(renamed)}, of the last episode?"
        )


def _check_claims(sweep: Sweep, file: str) -> None:
    """Refuse duplicate ids of claims, and references to labels or variants that the sweep does not have."""
    variants = {point.variant for point in sweep.points}
    relative_to = sweep.report.get("relative_to")
    if relative_to is not None and relative_to not in variants:
        raise ConfigError(
            f"{file}: report.relative_to: got {shown(relative_to)}; unknown variant"
            f"{allowed_names(relative_to, variants)}"
        )
    figures = [*figure_modules(), *TABLES]
    for name in sweep.report.get("figures", ()):
        if name not in figures:
            raise ConfigError(
                f"{file}: report.figures: got {shown(name)}; allowed: {', '.join(figures)}"
                f"{did_you_mean(name, figures)}"
            )
    for key in ("rank_by", "column"):
        _check_column(sweep, sweep.report.get(key), f"{file}: report.{key}")
    seen = set()
    for index, claim in enumerate(sweep.claims):
        where = f"{file}: claims.{index}"
        if claim.id in seen:
            raise ConfigError(f"{where}.id: got {shown(claim.id)}; allowed: a unique id")
        seen.add(claim.id)
        values = dict(claim.test)
        if not any(isinstance(value, Window) for value in values.values()):
            _check_column(sweep, values.get("column"), f"{where}.test.column")
        known = {point.variant if claim.test.by == "variant" else point.label for point in sweep.points}
        for name in claim.test.names:
            if name not in known:
                raise ConfigError(
                    f"{where}.test: got {shown(name)}; unknown {claim.test.by}{allowed_names(name, known)}"
                )
    explained, names = set(), available("sweeps")
    for index, explanation in enumerate(sweep.report.get("explanations", ())):
        where = f"{file}: report.explanations.{index}"
        for name in explanation["claims"]:
            if name not in seen:
                raise ConfigError(f"{where}.claims: got {shown(name)}; unknown id{allowed_names(name, seen)}")
            if name in explained:
                raise ConfigError(f"{where}.claims: got {shown(name)}; allowed: one explanation of a claim")
            explained.add(name)
        for name in explanation.get("sweeps", ()):
            if name not in names:
                raise ConfigError(f"{where}.sweeps: got {shown(name)}{allowed_names(name, names)}")
