"""The settings that a search varies: `key=low:high`, `key=low:high:log`, or choices, `key=a,b,c`."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

from bojax.config.component import Component
from bojax.config.errors import ConfigError
from bojax.config.overrides import SOURCE, parse_overrides
from bojax.config.settings import RESERVED
from bojax.optimisation.space import Axis, Choice, Range
from bojax.report.text import is_number

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"(?P<key>[^=]+)=(?P<low>{_NUMBER}):(?P<high>{_NUMBER})(?P<log>:log)?")
_CHOICES = re.compile(r"(?P<key>[^=]+)=(?P<values>[^\[\]{}\"']*,[^\[\]{}\"']*)")
"""Choices; a value in brackets or quotes is a list, a mapping or a text."""

EXAMPLE = "planner.exploration=0.1:10:log"


class Asked(NamedTuple):
    """A range or choices as given: the two bounds or the choices as text."""

    key: str
    values: tuple[str, ...]
    is_choice: bool
    is_log: bool = False  # whether a range is searched by the logarithm

    @property
    def text(self) -> str:
        """The values as they were given."""
        return ("," if self.is_choice else ":").join(self.values)


def split_ranges(words: Iterable[str]) -> tuple[list[Asked], list[str]]:
    """The ranges and choices among the words of a command line, and the other words.

    Raises:
        ConfigError: The bounds are in the wrong order, or not positive for `log`; choices are empty or equal;
            a key cannot be tuned, or is given twice.
    """
    asked, others = [], []
    for word in words:
        if match := _RANGE.fullmatch(word):
            bounds = match["low"], match["high"]
            asked.append(
                Asked(match["key"].strip(), bounds, is_choice=False, is_log=match["log"] is not None)
            )
        elif match := _CHOICES.fullmatch(word):
            choices = tuple(value.strip() for value in match["values"].split(","))
            asked.append(Asked(match["key"].strip(), choices, is_choice=True))
        else:
            others.append(word)
    for each in asked:
        got = f"{SOURCE}: {each.key}: got {each.text}; allowed: "
        if (first := each.key.partition(".")[0]) in (*RESERVED, "experiment"):
            raise ConfigError(f"{got}settings of the experiment; {first} cannot be tuned")
        if each.is_choice:
            if "" in each.values or len(set(each.values)) < len(each.values):
                raise ConfigError(f"{got}choices that differ, such as planner=kcbts,sbo")
            continue
        low, high = map(float, each.values)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(f"{got}low:high with low < high, both finite")
        if each.is_log and low <= 0.0:
            raise ConfigError(f"{got}low > 0, for log")
    parse_overrides([f"{each.key}={each.values[0]}" for each in asked])  # refuses a key that is given twice
    return asked, others


def axis_of(asked: Asked, configs: Sequence[Component], written: Component) -> Axis:
    """The range or the choices, given the validated experiments with each of its values, and as written.

    Raises:
        ConfigError: The setting is not a number, or for choices neither a number, a text nor a part.
    """
    values = [value_at(config, asked.key) for config in configs]
    got = f"{SOURCE}: {asked.key}: got {asked.text}; allowed: "
    if asked.is_choice:
        if None in values:
            raise ConfigError(f"{got}choices of a number, a text, true and false, or a part")
        if len(set(values)) < len(values):
            raise ConfigError(f"{got}choices that differ, such as planner=kcbts,sbo")
        return Choice(asked.key, tuple(values))
    low, high = values
    if not (is_number(low) and is_number(high)):
        raise ConfigError(f"{got}the range of a number, such as {EXAMPLE}")
    # A setting without a declared type, as in `env.kwargs`, is no integer if it is none in the config.
    known = (low, high, value_at(written, asked.key))
    is_integer = all(isinstance(value, int) for value in known if value is not None)
    return Range(asked.key, low, high, asked.is_log, is_integer)


def value_at(config: Component, key: str) -> Any:
    """The number, text or Boolean at a dotted path, or the kind of the part there; None for anything else."""
    value: Any = reduce(_part_at, key.split("."), config)
    if isinstance(value, Component):
        return getattr(value, "kind", None)
    return value if isinstance(value, int | float | str) else None


def _part_at(part: Any, name: str) -> Any:
    """A setting of a part, or a value of a mapping, such as `env.kwargs`; None if there is none."""
    return part.get(name) if isinstance(part, Mapping) else getattr(part, name, None)


def described(axes: Sequence[Axis], values: Sequence[Any]) -> str:
    """Values with their keys, in one line."""
    shown = (f"{value:g}" if is_number(value) else str(value) for value in values)
    return ", ".join(f"{each.key} {text}" for each, text in zip(axes, shown, strict=True))
