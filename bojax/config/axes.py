"""The axes of a sweep, the points of their grid or zip, and the parts that their dotted paths lead to."""

import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bojax.config.component import Component, merged, registry, slot_of
from bojax.config.errors import ConfigError, dotted, shown
from bojax.config.limits import POINTS
from bojax.config.overrides import Override, apply, assign
from bojax.config.settings import RESERVED

Path = tuple[str, ...]


@dataclass(frozen=True)
class Place:
    """The setting at a path."""

    role: str | None = None  # role of the component at the path; None for a plain setting
    kind: str | None = None  # kind of the component, given or by default


def look_up(experiment: Mapping[str, Any], path: Path) -> Place | None:
    """The setting at a path; None if the schemas have no such setting. Import paths are not followed."""
    place = Place("experiment", experiment.get("kind"))
    schema = registry.get("experiment", {}).get(str(place.kind))
    raw: Any = experiment
    default: Any = None
    for depth, name in enumerate(path):
        if schema is None:  # an import path or an unknown kind: any setting is possible
            return Place()
        if name not in schema.model_fields:
            return None
        field = schema.model_fields[name]
        default = getattr(default if isinstance(default, schema) else None, name, field.default)
        raw = raw.get(name) if isinstance(raw, Mapping) else None
        slot = slot_of(field)
        if slot is None:
            return Place() if depth == len(path) - 1 else None
        kind = raw.get("kind") if isinstance(raw, Mapping) else raw
        if kind is None and isinstance(default, Component):
            kind = default.kind
        place = Place(slot.role, kind if isinstance(kind, str) else None)
        schema = registry.get(slot.role, {}).get(str(kind))
    return place


@dataclass(frozen=True)
class Choice:
    """One value on an axis."""

    axis: Path  # dotted path of the axis
    name: str | None  # name of the value on an axis of named subtrees, otherwise None
    value: Any  # new value at the path; a named subtree is merged into the value of the base

    def apply(self, experiment: Mapping[str, Any], source: str) -> dict[str, Any]:
        """The experiment with this choice applied; `source` is the file of the axis."""
        place = look_up(experiment, self.axis)
        value = self.value
        if self.name is not None and isinstance(value, Mapping):
            kinds = registry.get(place.role, {}) if place and place.role else {}
            if "kind" not in value and self.name in kinds:
                value = {"kind": self.name, **value}
            below = _get(experiment, self.axis)
            if place and place.kind and not isinstance(below, str):
                below = {"kind": place.kind} | (below or {})
            value = merged(below, value) if below is not None else value
        return assign(experiment, self.axis, value, f"{source}: axes.{dotted(self.axis)}")

    def sets(self, path: Path) -> bool:
        """Whether this choice sets the value at `path`, or a value below it."""
        below, value = path[len(self.axis) :], self.value
        for name in below:
            if not isinstance(value, Mapping) or name not in value:
                return name == "kind" and isinstance(value, str)
            value = value[name]
        return True


Combination = tuple[Choice, ...]


def read_axes(axes: Mapping[str, Any], combine: str, source: str) -> list[Combination]:
    """The combinations of choices, in the order of the file; without axes, one empty combination."""
    is_zip = combine == "zip" and len(axes) > 1
    columns = [
        _read_axis(name, values, f"{source}: axes.{name}", may_repeat=is_zip) for name, values in axes.items()
    ]
    _refuse_overlap([column[0].axis for column in columns], source)
    if combine == "zip":
        lengths = {name: len(column) for name, column in zip(axes, columns, strict=True)}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} has {length}" for name, length in lengths.items())
            raise ConfigError(
                f"{source}: axes: got axes of different lengths ({listed}); allowed in a zip: equal lengths"
            )
        combinations = list(zip(*columns, strict=True)) if columns else [()]
        firsts: dict[Hashable, int] = {}
        for index, combination in enumerate(combinations):
            first = firsts.setdefault(tuple((c.name, _hashable(c.value)) for c in combination), index)
            if first != index:
                raise ConfigError(
                    f"{source}: axes: points {first} and {index} are equal; allowed in a zip: distinct points"
                )
        return combinations
    POINTS.check(math.prod(map(len, columns)), f"{source}: axes")
    return list(itertools.product(*columns))


def expand(
    experiment: Mapping[str, Any],
    combinations: Sequence[Combination],
    overrides: Sequence[Override],
    source: str,
) -> list[dict[str, Any]]:
    """The raw experiment of every point.

    `overrides` are those below an axis; each is applied to every point that has the setting.
    """
    points = []
    for combination in combinations:
        raw = dict(experiment)
        for choice in combination:
            raw = choice.apply(raw, source)
        points.append(raw)
    for override in overrides:
        fits = [look_up(raw, override.path) is not None for raw in points]
        # If no point has the setting, validation reports the unknown key and the nearest name.
        points = [
            apply(raw, override) if fit or not any(fits) else raw
            for raw, fit in zip(points, fits, strict=True)
        ]
    return points


def split_overrides(
    overrides: Sequence[Override], combinations: Sequence[Combination], source: str
) -> tuple[list[Override], list[Override]]:
    """The overrides of the base, and those below an axis."""
    base, below = [], []
    for override in overrides:
        axes = {choice.axis for choice in combinations[0] if _is_prefix(choice.axis, override.path)}
        for choice in itertools.chain.from_iterable(combinations):
            if choice.axis in axes and choice.sets(override.path):
                where = dotted(choice.axis) + (f".{choice.name}" if choice.name else "")
                raise ConfigError(
                    f"command line: {dotted(override.path)}: got {shown(override.value)}; "
                    f"a swept key cannot be overridden (axes.{where} in {source})"
                )
        (below if axes else base).append(override)
    return base, below


def _read_axis(name: str, values: Any, where: str, may_repeat: bool) -> list[Choice]:
    axis = tuple(name.split("."))
    if not all(axis):
        raise ConfigError(
            f"{where}: got an empty name in the path; allowed: a dotted path, such as planner.depth"
        )
    if axis[0] in (*RESERVED, "experiment"):
        raise ConfigError(f"{where}: {axis[0]} cannot be swept; allowed: settings of the experiment")
    if not isinstance(values, list | dict):
        raise ConfigError(f"{where}: got {shown(values)}; allowed: a list of values, or named subtrees")
    if not values:
        raise ConfigError(f"{where}: is empty; allowed: one value or more")
    POINTS.check(len(values), where)
    if isinstance(values, dict):
        for choice in values:
            if not choice or "/" in choice:
                raise ConfigError(
                    f"{where}: got the name {shown(choice)}; allowed: a nonempty name without /"
                )
        return [Choice(axis, choice, {} if value is None else value) for choice, value in values.items()]
    firsts: dict[Hashable, int] = {}
    for index, value in enumerate(values):
        if isinstance(value, dict):
            raise ConfigError(
                f"{where}: got {shown(value)}; allowed: named subtrees, `{name}: {{NAME: {{...}}}}`"
            )
        first = firsts.setdefault(_hashable(value), index)
        if first != index and not may_repeat:
            raise ConfigError(
                f"{where}: got {shown(values[first])} and {shown(value)}, which are equal; allowed: distinct "
                "values"
            )
    return [Choice(axis, None, value) for value in values]


def _hashable(value: Any) -> Hashable:
    """A hashable key for a YAML value; equal values have equal keys, as 1, 1.0 and true have."""
    if isinstance(value, list):
        return "list", *map(_hashable, value)
    if isinstance(value, dict):
        return frozenset((name, _hashable(item)) for name, item in value.items())
    return value


def _refuse_overlap(axes: Sequence[Path], source: str) -> None:
    """Refuse an axis that sets a parent of what an earlier axis sets."""
    for first, second in itertools.permutations(axes, 2):
        if _is_prefix(first, second) and axes.index(first) > axes.index(second):
            outer, inner = f"axes.{dotted(first)}", f"axes.{dotted(second)}"
            raise ConfigError(f"{source}: {outer}: overwrites {inner}; allowed: {outer} before {inner}")


def _is_prefix(prefix: Path, path: Path) -> bool:
    return path[: len(prefix)] == prefix


def _get(raw: Any, path: Path) -> Any:
    for name in path:
        if isinstance(raw, str):
            raw = {"kind": raw}
        raw = raw.get(name) if isinstance(raw, Mapping) else None
    return raw
