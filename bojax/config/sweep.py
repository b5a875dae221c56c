"""Loading a sweep: its file is read, overridden, expanded into points, validated and checked."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pydantic

from bojax.config.axes import Combination, expand, look_up, read_axes, split_overrides
from bojax.config.component import RECORDED, Component, Slot, merged
from bojax.config.errors import ConfigError, Location, dotted, from_validation, shown
from bojax.config.files import shipped
from bojax.config.limits import COUNT, RUNS, counts_of
from bojax.config.origin import Origin
from bojax.config.overrides import SOURCE, Override, apply, assign, parse_overrides
from bojax.config.points import Point, Sweep
from bojax.config.settings import RESERVED, Settings, split
from bojax.config.sweep_checks import check_sweep
from bojax.config.sweep_file import Source, Written, read_config, read_sweep

_EXPERIMENT = pydantic.TypeAdapter(Annotated[Component, Slot("experiment")])

DEFAULT_RUNS = 200
"""Default of `runs` in a sweep: enough for the figures of the thesis."""


def load_sweep(
    source: Source, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The sweep of a file in `sweeps/`, given by name, path or content, with dotted `key=value` overrides."""
    written = read_sweep(source)
    changes = _changes(overrides, runs, seed)
    combinations = read_axes(written.content.axes, written.content.combine, written.file)
    sweep = replace(_expanded(written, changes, combinations, DEFAULT_RUNS), published=_published(written))
    check_sweep(sweep, written.file)
    return sweep


def load_config(
    source: Source, overrides: Sequence[str] = (), runs: int | None = None, seed: int | None = None
) -> Sweep:
    """The experiment of a file in `configs/`, as a sweep of one point; see `load_sweep`."""
    return _expanded(read_config(source), _changes(overrides, runs, seed), [()], 1)


@dataclass(frozen=True)
class Setting:
    """A setting of a variation of a sweep, which overrides the sweep's own, those of its axes included."""

    path: tuple[str, ...]
    value: Any
    of: tuple[str, ...] = ()  # labels or variants of the points that get it; all points that have it if empty
    not_of: tuple[str, ...] = ()  # labels or variants of points that do not get it
    origin: str = "variation"  # what sets it, for messages

    def is_of(self, point: Point, experiment: Mapping[str, Any]) -> bool:
        """Whether a point of the sweep, whose raw experiment is given, gets this setting."""
        names = {point.label, point.variant}
        is_named = (not self.of or bool(names & {*self.of})) and not names & {*self.not_of}
        return is_named and look_up(experiment, self.path) is not None


def vary(
    source: Source,
    axis: str,
    variations: Mapping[int, Sequence[Setting]],
    runs: int | None = None,
    seed: int | None = None,
) -> Sweep:
    """A sweep with all its points once for each variation, one variation after the other.

    Points of one variant with the same settings are one point, whose runs all these variations share: results
    depend on settings, seed and number of a run alone. The variations have numbers; a column named `axis` has
    those of each point, with spaces between.
    """
    written = read_sweep(source)
    own = load_sweep(source, (), runs, seed)
    combinations = read_axes(written.content.axes, written.content.combine, written.file)
    experiments = expand(split(written.base)[1], combinations, (), written.file)
    known: dict[str, Component] = {}
    points: list[Point] = []
    places: list[Callable[[Location], str]] = []  # what locates the settings of each point
    shared: dict[tuple[str, str], list[int]] = {}  # numbers of the variations of each point
    for number, settings in variations.items():
        for point, raw in zip(own.points, experiments, strict=True):
            varied, origins = raw, dict[tuple[str, ...], str]()
            for each in settings:
                if each.is_of(point, varied):
                    if each.path in origins:
                        raise ConfigError(
                            f"{each.origin}: sets {dotted(each.path)} of {point.variant}, which "
                            f"{origins[each.path]} sets too"
                        )
                    origins[each.path] = each.origin
                    varied = assign(varied, each.path, each.value, each.origin)
            changed = partial(_origin_in, origins, point.variant)
            locate = changed if origins else partial(own.locate, point.index)
            key = json.dumps(varied, sort_keys=True, default=str)
            if key not in known:
                try:
                    known[key] = validate_experiment(varied)
                except pydantic.ValidationError as error:
                    raise from_validation(error, locate) from error
            config = known[key]
            same = shared.setdefault((point.variant, config.model_dump_json()), [])
            same.append(number)
            if len(same) == 1:
                places.append(locate)
                points.append(Point(len(points), config.label, point.variant, point.swept, config))
    points = [
        replace(point, swept={**point.swept, axis: " ".join(map(str, numbers))})
        for point, numbers in zip(points, shared.values(), strict=True)
    ]
    RUNS.check(own.runs * len(points), f"{written.file}: runs")
    return replace(
        own, points=tuple(points), published=None, locate=lambda index, location: places[index](location)
    )


def _origin_in(origins: Mapping[tuple[str, ...], str], variant: str, location: Location) -> str:
    """Where a setting of a varied point comes from, for messages."""
    above = [origin for path, origin in origins.items() if path == location[: len(path)]]
    return f"{above[-1] if above else '; '.join(origins.values())}: {dotted(location)} of {variant}"


def load_published(name: str) -> Sweep:
    """A sweep of bojax by name, whatever files the working directory has."""
    return load_sweep(str(shipped("sweeps") / f"{name}.yaml"))


def validate_experiment(settings: Any, *, is_recorded: bool = False) -> Component:
    """The experiment that a mapping of settings describes.

    If results record these settings, the files of data that they name, with the hash of their content, are
    not read again.

    Raises:
        pydantic.ValidationError: A setting is wrong.
    """
    return _EXPERIMENT.validate_python(settings, context=RECORDED if is_recorded else None)


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


def _expanded(
    written: Written, changes: Sequence[Override], combinations: Sequence[Combination], default_runs: int
) -> Sweep:
    """The sweep of a file, with changes from the command line and every setting validated."""
    settings, experiment = split(written.base)
    settings = merged({"title": written.name, "runs": default_runs, **settings}, written.own)
    in_base, below_axes = split_overrides(changes, combinations, written.file)
    for change in in_base:
        if change.path == ("experiment",):
            experiment = apply(experiment, Override(("kind",), change.value))
        elif change.path[0] in RESERVED:
            settings = apply(settings, change)
        else:
            experiment = apply(experiment, change)
    overridden = tuple(change.path for change in changes)
    origin = Origin(written.locate, written.file, tuple(written.own), overridden, combinations)
    points = []
    experiments = expand(experiment, combinations, below_axes, written.file)
    for index, (raw, combination) in enumerate(zip(experiments, combinations, strict=True)):
        locate = partial(origin.point, index)
        try:
            config = validate_experiment(raw)
        except pydantic.ValidationError as error:
            raise from_validation(error, locate, siblings=(*RESERVED, "experiment")) from error
        for path, number, _ in counts_of(config):
            COUNT.check(number, locate(path))
        points.append(_point(index, config, combination))
    try:
        values = Settings.model_validate(settings)
    except pydantic.ValidationError as error:
        raise from_validation(error, origin.setting) from error
    RUNS.check(values.runs * len(points), origin.setting(("runs",)))
    kind = experiment.pop("kind")
    return Sweep(
        name=written.name,
        points=tuple(points),
        **dict(values),
        report=written.content.report.model_dump(mode="json", exclude_unset=True),
        claims=written.content.claims,
        base={"experiment": kind, **experiment},
        source=written.path,
        locate=origin.point,
    )


def _published(written: Written) -> Path | None:
    """The file of the sweep of bojax that a sweep file is, or whose name it has."""
    folder, path = shipped("sweeps").resolve(), written.path.resolve()
    published = path if path.parent == folder else folder / f"{written.name}.yaml"
    return published if published.is_file() else None


def _point(index: int, config: Component, combination: Combination) -> Point:
    swept = {
        dotted(choice.axis): choice.name or _value_at(config, choice.axis, choice.value)
        for choice in combination
    }
    variant = "/".join(choice.name for choice in combination if choice.name is not None)
    return Point(index, config.label, variant or config.label, swept, config)


def _value_at(config: Any, path: Sequence[str], written: Any) -> Any:
    """A swept value as typed by its schema, where 1 can be the float 1.0, or else as written."""
    for name in path:
        config = getattr(config, name, None)
    return config if isinstance(config, bool | int | float | str) else written
