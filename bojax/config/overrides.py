"""Overrides `dotted.key=value` of a configuration that is not validated yet."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bojax.config.component import merged
from bojax.config.errors import ConfigError, dotted, shown
from bojax.config.yaml_file import parse

SOURCE = "command line"
"""Name of the command line in messages, in the place of a file name."""

MAX_DEPTH = 50
"""Maximum number of names in a dotted path; the deepest setting of bojax has far fewer."""


@dataclass(frozen=True)
class Override:
    """One setting from the command line."""

    path: tuple[str, ...]  # path of the setting
    value: Any  # value of the setting, typed by YAML


def parse_overrides(texts: Iterable[str]) -> list[Override]:
    """The overrides, shallow paths first: the order of `planner=sbo planner.depth=2` has no effect."""
    overrides: dict[tuple[str, ...], Override] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        path = tuple(key.strip().split("."))
        if not equals or not all(path):
            raise ConfigError(
                f"{SOURCE}: {text}: is not an override; allowed: key=value, such as planner.iterations=100"
            )
        if len(path) > MAX_DEPTH:
            raise ConfigError(f"{SOURCE}: {key}: got {len(path)} names; allowed: at most {MAX_DEPTH}")
        if path in overrides:
            hint = "; quote a value with braces" if ":" in value else ""  # the shell expands braces
            raise ConfigError(f"{SOURCE}: {key}: given twice{hint}")
        try:
            overrides[path] = Override(path, parse(value, SOURCE))
        except ConfigError as error:
            is_cut = any(value.count(left) > value.count(right) for left, right in ("{}", "[]"))
            hint = f"; quote a value with braces or spaces: '{key}={value} ...'" if is_cut else ""
            reason = str(error).removeprefix(SOURCE).lstrip(":0123456789 ")
            reason = reason.removeprefix(f"got {shown(value)}; ")
            raise ConfigError(f"{SOURCE}: {key}: got {value}; {reason}{hint}") from error
    return sorted(overrides.values(), key=lambda override: (len(override.path), override.path[-1] != "kind"))


def apply(raw: Mapping[str, Any], override: Override) -> dict[str, Any]:
    """A copy of `raw` with an override applied."""
    return assign(raw, override.path, override.value, f"{SOURCE}: {dotted(override.path)}")


def assign(raw: Mapping[str, Any], path: tuple[str, ...], value: Any, where: str) -> dict[str, Any]:
    """A copy of `raw` with `value` at `path`; a new `kind` discards the settings of the old kind.

    A mapping without `kind` changes settings of what is there, and an empty one empties it. Messages call the
    setting `where`.
    """
    name, *rest = path
    if rest:
        below = raw.get(name)
        if isinstance(below, str):
            below = {"kind": below}
        elif below is None:
            below = {}
        elif not isinstance(below, Mapping):
            raise ConfigError(f"{where}: {name} is {shown(below)}, which has no settings")
        value = assign(below, tuple(rest), value, where)
    elif name == "kind" and raw.get("kind") != value:
        return {"kind": value}
    elif isinstance(value, Mapping) and value and "kind" not in value:
        value = merged(raw.get(name), value)
    return {**raw, name: value}
