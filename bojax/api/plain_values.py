"""What a caller gives, as the values that a YAML file can hold."""

import json
import math
import os
from collections.abc import Mapping
from typing import Any

from bojax.config.component import Component
from bojax.config.errors import ConfigError, dotted, shown
from bojax.config.overrides import SOURCE
from bojax.config.yaml_file import mapping_of


class PlainValues:
    """Plain values of what a caller gives."""

    def __init__(self):
        self.has_classes = False  # whether a class was among the values

    def mapping(self, value: Mapping[str, Any], name: str) -> dict[str, Any]:
        """A config as if read from a file: what a file cannot hold is refused under the same messages.

        Raises:
            ConfigError: A value has no form in a YAML file; messages call the file `name`.
        """
        return mapping_of(self.text(value, (), name).encode("utf-8", "surrogatepass"), name)

    def number(self, value: Any, key: str) -> Any:
        """A number that an argument gives, which may be one of NumPy or JAX."""
        return self._plain(value, (key,), SOURCE)

    def text(self, value: Any, path: tuple[str, ...], name: str) -> str:
        """A value as YAML on one line."""
        try:
            return json.dumps(self._plain(value, path, name), ensure_ascii=False)
        except RecursionError:
            raise ConfigError(f"{_where(path, name)}is nested too deeply, or contains itself") from None

    def _plain(self, value: Any, path: tuple[str, ...], name: str) -> Any:
        if isinstance(value, float) and not math.isfinite(value):  # YAML would read them as text
            raise ConfigError(f"{_where(path, name)}got {value}; allowed: a finite number")
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, type):
            return self._import_path(value, path, name)
        if isinstance(value, Component):
            return value.model_dump(mode="json")
        if isinstance(value, Mapping):
            if others := [key for key in value if not isinstance(key, str)]:
                raise ConfigError(f"{_where(path, name)}got the key {shown(others[0])}; allowed: text")
            return {key: self._plain(item, (*path, key), name) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [self._plain(item, (*path, str(index)), name) for index, item in enumerate(value)]
        if hasattr(value, "tolist"):  # numbers and arrays of NumPy and JAX
            return self._plain(value.tolist(), path, name)
        raise ConfigError(
            f"{_where(path, name)}got {shown(value)}, of type {type(value).__name__}; allowed: numbers, "
            "text, Booleans, lists, mappings, None, settings and classes of parts"
        )

    def _import_path(self, cls: type, path: tuple[str, ...], name: str) -> str:
        """The import path of a class, `module:Class`; classes of a notebook belong to `__main__`."""
        if "." in cls.__qualname__:
            raise ConfigError(
                f"{_where(path, name)}got the class {cls.__qualname__}; allowed: a class that is defined at "
                "the top level of a module or a notebook"
            )
        self.has_classes = True
        return f"{cls.__module__}:{cls.__qualname__}"


def path_of(given: Any, what: str, allowed: str = "a path") -> str:
    """A name or a path as text.

    Raises:
        ConfigError: It is neither, or it is empty; `what` and `allowed` are words of the message.
    """
    if isinstance(given, str | os.PathLike) and os.fspath(given):
        return os.fspath(given)
    raise ConfigError(f"{what}: got {shown(given)}, of type {type(given).__name__}; allowed: {allowed}")


def _where(path: tuple[str, ...], name: str) -> str:
    return f"{name}: {dotted(path)}: " if path else f"{name}: "
