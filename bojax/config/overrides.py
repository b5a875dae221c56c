"""Dotted `key=value` overrides of a raw configuration."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bojax.config.errors import ConfigError, dotted, shown
from bojax.config.yaml_file import parse

SOURCE = "command line"
"""What messages call the file of an override."""

MAX_DEPTH = 50
"""Most names in a dotted path; the deepest setting of bojax has far fewer."""


@dataclass(frozen=True)
class Override:
    """One setting from the command line.

    Attributes:
        path: Where it stands.
        value: Its value, typed by YAML.
    """

    path: tuple[str, ...]
    value: Any


def parse_overrides(texts: Iterable[str]) -> list[Override]:
    """The overrides, the outer ones first: `planner=sbo planner.depth=2` means the same in any order.

    Raises:
        ConfigError: A text is not `key=value`, or a key stands there twice.
    """
    overrides: dict[tuple[str, ...], Override] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        path = tuple(key.strip().split("."))
        if not equals or not all(path):
            raise ConfigError(f"{SOURCE}: {text}: an override is key=value, such as planner.iterations=100")
        if len(path) > MAX_DEPTH:
            raise ConfigError(f"{SOURCE}: {key}: got {len(path)} names; allowed: at most {MAX_DEPTH}")
        if path in overrides:
            hint = "; a value with braces has to be quoted" if ":" in value else ""  # a shell expands them
            raise ConfigError(f"{SOURCE}: {key}: given twice{hint}")
        try:
            overrides[path] = Override(path, parse(value, SOURCE))
        except ConfigError as error:
            is_cut = any(value.count(left) > value.count(right) for left, right in ("{}", "[]"))
            hint = f"; a value with braces or spaces has to be quoted: '{key}={value} ...'" if is_cut else ""
            reason = str(error).removeprefix(SOURCE).lstrip(":0123456789 ")
            raise ConfigError(f"{SOURCE}: {key}: got {value}; {reason}{hint}") from error
    return sorted(overrides.values(), key=lambda override: (len(override.path), override.path[-1] != "kind"))


def apply(raw: Mapping[str, Any], override: Override) -> dict[str, Any]:
    """A copy of `raw` with an override made."""
    return assign(raw, override.path, override.value, f"{SOURCE}: {dotted(override.path)}")


def assign(raw: Mapping[str, Any], path: tuple[str, ...], value: Any, where: str) -> dict[str, Any]:
    """A copy of `raw` with the value at `path`; a new `kind` drops the settings of the old one.

    Raises:
        ConfigError: There is a plain value on the way; `where` names the setting.
    """
    name, *rest = path
    if rest:
        below = raw.get(name)
        if isinstance(below, str):
            below = {"kind": below}
        elif below is None:
            below = {}
        elif not isinstance(below, Mapping):
            raise ConfigError(f"{where}: {name} is {shown(below)}, with nothing below it")
        value = assign(below, tuple(rest), value, where)
    elif name == "kind" and raw.get("kind") != value:
        return {"kind": value}
    return {**raw, name: value}
