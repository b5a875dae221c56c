"""A YAML reader that refuses duplicate keys and reports errors with file and line.

PyYAML follows YAML 1.1, which reads `1e-5` as text, `no` as false, `1:30` as 90 and `017` as 15. This reader
follows the core schema of YAML 1.2, which reads `1e-5` as a number, `no` and `1:30` as text, and `017` as 17;
its octal numbers begin with `0o`.
"""

import copy
import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from typing_extensions import override

from bojax.config.errors import ConfigError, control_character, shown
from bojax.text import one_line

MAX_BYTES = 4 * 2**20
"""Maximum size of a file, in bytes. Parsing takes about 10 s per MiB (measured)."""

MAX_NODES = 500_000
"""Maximum number of values, including those repeated by aliases; each takes about 700 bytes (measured)."""

MAX_REMEMBERED = 2**16
"""Maximum number of characters of a file whose value is remembered: a command reads some files many times."""

_TAG = "tag:yaml.org,2002:"

_NUMBER = r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"

_PATTERNS = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    "float": (rf"{_NUMBER}|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", list("-+.0123456789")),
    "merge": (r"<<", ["<"]),
}
"""The pattern of the scalars of each tag, and the characters that they begin with."""


def _int(text: str) -> int:
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    value = int(text, base) if len(text) < 40 else 2**64  # int() takes quadratic time for long texts
    if not -(2**63) <= value < 2**63:
        raise ValueError("allowed: an integer between -2^63 and 2^63 - 1")
    return value


_CONSTRUCTORS: dict[str, Callable[[str], Any]] = {
    "null": lambda text: None,
    "bool": lambda text: text.lower() == "true",
    "int": _int,
    "float": lambda text: float(re.sub(r"\.(?=[ina])", "", text.lower())),
    "str": str,
}
"""The function from the text of a scalar to its value, by tag. All other tags are refused."""


class _Loader(yaml.SafeLoader):
    """A loader of YAML 1.2 scalars that limits the number of values."""

    yaml_implicit_resolvers: dict = {}
    num_nodes = 0

    @override
    def compose_node(self, parent: Any, index: Any) -> Any:
        self.count()
        return super().compose_node(parent, index)

    def count(self) -> None:
        """Count one more value."""
        self.num_nodes += 1
        if self.num_nodes > MAX_NODES:
            raise _TooLarge


class _TooLarge(Exception):
    """More values than `MAX_NODES`."""


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes text which YAML 1.1 or YAML 1.2 would read as another value."""


for _name, (_pattern, _first) in _PATTERNS.items():
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(_TAG + _name, re.compile(f"^(?:{_pattern})$"), _first)


def dump(value: Any) -> str:
    """The YAML text of plain values, which reads as equal values; keys keep their order."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def read_mapping(path: Path, name: str) -> dict[str, Any]:
    """The mapping that a YAML file holds; messages call the file `name`."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}") from error
    return mapping_of(content, name)


def mapping_of(content: bytes, name: str) -> dict[str, Any]:
    """The mapping that the content of a YAML file holds, as `read_mapping`.

    The content of a file that is too long may be cut off after `MAX_BYTES + 1` bytes.
    """
    if len(content) > MAX_BYTES:
        raise ConfigError(
            f"{name}: has more than {MAX_BYTES / 2**20:.0f} MiB; allowed: at most that much YAML, which "
            "takes about 40 s to read"
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name}: is not UTF-8 text (byte {error.start})") from error
    value = copy.deepcopy(_parse_once(text, name)) if len(text) <= MAX_REMEMBERED else parse(text, name)
    if value is None:
        raise ConfigError(f"{name}: is empty; allowed: a mapping of settings (key: value)")
    if not isinstance(value, dict):
        kind = {list: "a list", str: "text", bool: "a Boolean"}.get(type(value), "a number")
        raise ConfigError(f"{name}: holds {kind}; allowed: a mapping of settings (key: value)")
    return value


def parse(text: str, name: str) -> Any:
    """The value of a YAML text."""
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            loader.num_nodes = 0  # count again, now including values that aliases repeat
            return None if node is None else _construct(loader, node, name)
        finally:
            loader.dispose()
    except _TooLarge:
        raise ConfigError(
            f"{name}: holds too many values; allowed: at most {MAX_NODES:,}, with those that aliases repeat, "
            f"which take about {MAX_NODES * 700 / 2**20:.0f} MiB of memory"
        ) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f":{mark.line + 1}" if mark else ""
        raise ConfigError(f"{name}{where}: is not YAML: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}: is not YAML: {one_line(error)}") from error
    except RecursionError as error:  # also of an alias within the value that it stands for
        raise ConfigError(f"{name}: is nested too deeply") from error


_parse_once = functools.lru_cache(maxsize=256)(parse)


def _construct(loader: _Loader, node: yaml.Node, name: str) -> Any:
    where = f"{name}:{node.start_mark.line + 1}"
    loader.count()
    tag = node.tag.removeprefix(_TAG)
    if isinstance(node, yaml.SequenceNode) and tag == "seq":
        return [_construct(loader, child, name) for child in node.value]
    if isinstance(node, yaml.MappingNode) and tag == "map":
        return _construct_mapping(loader, node, name)
    if not isinstance(node, yaml.ScalarNode) or tag not in _CONSTRUCTORS:
        written = "!!" + tag if node.tag.startswith(_TAG) else node.tag
        allowed = ", ".join("!!" + known for known in _CONSTRUCTORS)
        raise ConfigError(f"{where}: got the tag {written}; allowed: {allowed}, each for a plain value")
    text = node.value
    if sign := control_character(text):
        raise ConfigError(f"{where}: got {shown(text)}; allowed: text without the character {sign}")
    if tag in _PATTERNS and not re.fullmatch(_PATTERNS[tag][0], text):
        raise ConfigError(f"{where}: got {shown(text)}; allowed: a value of type !!{tag}")
    try:
        return _CONSTRUCTORS[tag](text)
    except ValueError as error:
        raise ConfigError(f"{where}: got {shown(text)}; {error}") from error


def _construct_mapping(loader: _Loader, node: yaml.MappingNode, name: str) -> dict[str, Any]:
    own: dict[str, Any] = {}
    inherited: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        value = _construct(loader, value_node, name)
        if key_node.tag == "tag:yaml.org,2002:merge":
            for base in reversed(value if isinstance(value, list) else [value]):
                if not isinstance(base, dict):
                    raise ConfigError(
                        f"{name}:{line}: <<: got {shown(value)}; allowed: a mapping or a list of mappings"
                    )
                inherited.update(base)
            continue
        key = key_node.value
        if not isinstance(key_node, yaml.ScalarNode) or not isinstance(key, str):
            raise ConfigError(f"{name}:{line}: got a key that is not text; allowed: a name")
        if sign := control_character(key):
            raise ConfigError(
                f"{name}:{line}: got the key {shown(key)}; allowed: text without the character {sign}"
            )
        if key in lines:
            raise ConfigError(f'{name}:{line}: duplicate key "{key}" (first on line {lines[key]})')
        lines[key] = line
        own[key] = value
    return inherited | own
