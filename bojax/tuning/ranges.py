"""The settings that a search varies, and their ranges: `key=low:high` or `key=low:high:log`."""

import math
import re
from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any, NamedTuple

from bojax.config.component import Component
from bojax.config.errors import ConfigError
from bojax.config.overrides import SOURCE, parse_overrides
from bojax.config.settings import RESERVED
from bojax.optimisation.space import Range

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"(?P<key>[^=]+)=(?P<low>{_NUMBER}):(?P<high>{_NUMBER})(?P<log>:log)?")

EXAMPLE = "planner.exploration=0.1:10:log"


class Asked(NamedTuple):
    """A range as given, with bounds as text, and whether values are searched by their logarithm."""

    key: str
    low: str
    high: str
    is_log: bool


def split_ranges(words: Iterable[str]) -> tuple[list[Asked], list[str]]:
    """The ranges among the words of a command line, and the other words.

    Raises:
        ConfigError: The bounds are in the wrong order, or not positive for `log`; a key cannot be tuned, or
            is given twice.
    """
    asked, others = [], []
    for word in words:
        if match := _RANGE.fullmatch(word):
            asked.append(Asked(match["key"].strip(), match["low"], match["high"], match["log"] is not None))
        else:
            others.append(word)
    for each in asked:
        got = f"{SOURCE}: {each.key}: got {each.low}:{each.high}; allowed: "
        low, high = float(each.low), float(each.high)
        if (first := each.key.partition(".")[0]) in (*RESERVED, "experiment"):
            raise ConfigError(f"{got}settings of the experiment; {first} cannot be tuned")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(f"{got}low:high with low < high, both finite")
        if each.is_log and low <= 0.0:
            raise ConfigError(f"{got}low > 0, for log")
    parse_overrides([f"{each.key}={each.low}" for each in asked])  # refuses a key that is given twice
    return asked, others


def range_of(asked: Asked, at_low: Component, at_high: Component) -> Range:
    """The range, given the validated experiments at its bounds.

    Raises:
        ConfigError: The setting is not a number.
    """
    low, high = (value_at(config, asked.key) for config in (at_low, at_high))
    if low is None or high is None:
        raise ConfigError(
            f"{SOURCE}: {asked.key}: got {asked.low}:{asked.high}; allowed: the range of a number, "
            f"such as {EXAMPLE}"
        )
    is_integer = isinstance(low, int) and isinstance(high, int)
    return Range(asked.key, low, high, asked.is_log, is_integer)


def value_at(config: Component, key: str) -> int | float | None:
    """The number at a dotted path; None if the setting is not a number."""
    value: Any = reduce(lambda part, name: getattr(part, name, None), key.split("."), config)
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def described(ranges: Sequence[Range], values: Sequence[int | float]) -> str:
    """Values with their keys, in one line."""
    return ", ".join(f"{each.key} {value:g}" for each, value in zip(ranges, values, strict=True))
