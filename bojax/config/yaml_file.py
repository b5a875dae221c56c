"""Reading YAML: plain values of YAML 1.2, every key once, errors with file and line.

PyYAML follows YAML 1.1, in which `1e-5` is text, `no` is false and `1:30` is ninety. Here scalars are
those of the YAML 1.2 core schema, so that a setting means what it looks like.
"""

import re
from pathlib import Path
from typing import Any

import yaml

from bojax.config.errors import ConfigError


class _Loader(yaml.SafeLoader):
    """A safe loader with the scalars of YAML 1.2."""

    yaml_implicit_resolvers: dict = {}


for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", list("-+0123456789")),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", list("-+.0123456789")),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", list("-+.")),
    ("merge", r"<<", ["<"]),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first)


def _construct_int(loader: _Loader, node: yaml.ScalarNode) -> int:
    return int(loader.construct_scalar(node))  # the inherited one reads 010 as eight


_Loader.add_constructor("tag:yaml.org,2002:int", _construct_int)


def read_mapping(path: Path, name: str) -> dict[str, Any]:
    """The mapping that a YAML file holds.

    Args:
        path: The file.
        name: How messages call it.

    Raises:
        ConfigError: The file cannot be read, is empty, is not YAML, is not a mapping, or has a key twice.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name}: is not text in UTF-8 (byte {error.start})") from error
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}") from error
    value = parse(text, name)
    if value is None:
        raise ConfigError(f"{name}: is empty; a mapping of settings (key: value) is expected")
    if not isinstance(value, dict):
        raise ConfigError(
            f"{name}: holds a {_name_of(value)}; a mapping of settings (key: value) is expected"
        )
    return value


def parse(text: str, name: str) -> Any:
    """The value of a YAML text.

    Raises:
        ConfigError: The text is not YAML, or has a key twice.
    """
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            return None if node is None else _construct(loader, node, name, ())
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f":{mark.line + 1}" if mark else ""
        raise ConfigError(f"{name}{where}: is not YAML: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}: is not YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ConfigError(f"{name}: is nested too deeply") from error


def _construct(loader: _Loader, node: yaml.Node, name: str, ancestors: tuple[yaml.Node, ...]) -> Any:
    where = f"{name}:{node.start_mark.line + 1}"
    if any(node is ancestor for ancestor in ancestors):
        raise ConfigError(f"{where}: an alias refers to the value that it stands in")
    ancestors = (*ancestors, node)
    if isinstance(node, yaml.SequenceNode):
        return [_construct(loader, child, name, ancestors) for child in node.value]
    if isinstance(node, yaml.MappingNode):
        return _construct_mapping(loader, node, name, ancestors)
    try:
        return loader.construct_object(node)
    except ValueError as error:
        raise ConfigError(f"{where}: {node.value!r}: {error}") from error


def _construct_mapping(
    loader: _Loader, node: yaml.MappingNode, name: str, ancestors: tuple[yaml.Node, ...]
) -> dict[str, Any]:
    own: dict[str, Any] = {}
    inherited: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        value = _construct(loader, value_node, name, ancestors)
        if key_node.tag == "tag:yaml.org,2002:merge":
            for base in reversed(value if isinstance(value, list) else [value]):
                if not isinstance(base, dict):
                    raise ConfigError(f"{name}:{line}: << takes a mapping or a list of mappings")
                inherited.update(base)
            continue
        key = key_node.value
        if not isinstance(key_node, yaml.ScalarNode) or not isinstance(key, str):
            raise ConfigError(f"{name}:{line}: a key must be a name")
        if key in lines:
            raise ConfigError(f'{name}:{line}: duplicate key "{key}" (first on line {lines[key]})')
        lines[key] = line
        own[key] = value
    return inherited | own


def _name_of(value: Any) -> str:
    return {list: "list", str: "text", bool: "truth value"}.get(type(value), "number")
