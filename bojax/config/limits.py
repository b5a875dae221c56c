"""Limits on the size of what is asked for, derived from the memory that it takes."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pydantic

from bojax.config.component import Component
from bojax.config.errors import ConfigError, Location


@dataclass(frozen=True)
class Limit:
    """A limit on a count: as many as fit into half the memory of the machine."""

    name: str  # noun for messages
    bytes_each: int  # memory per item, in bytes
    at_least: int  # lower bound of the limit on any machine

    @property
    def allowed(self) -> int:
        """The largest number accepted on this machine."""
        return max(self.at_least, budget() // self.bytes_each)

    def check(self, number: int, where: str) -> None:
        """Refuse a number above the limit; `where` names the setting."""
        if number > self.allowed:
            raise ConfigError(
                f"{where}: got {number:,} {self.name}, which take about {memory(number * self.bytes_each)} "
                f"of memory; allowed: at most {self.allowed:,}"
            )

    def bound(self, number_of: Callable[[Any], int] = int) -> pydantic.AfterValidator:
        """A validator of a setting, by the number of items that its value asks for."""

        def check(value: Any) -> Any:
            if number_of(value) > self.allowed:
                raise ValueError(
                    f"allowed: at most {self.allowed:,} {self.name}, which take about "
                    f"{memory(self.allowed * self.bytes_each)} of memory"
                )
            return value

        return pydantic.AfterValidator(check)


def budget() -> int:
    """Half the memory of the machine, in bytes: what the input of a command may ask for."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2


def read_within(limit: Limit, path: Path, where: str) -> bytes:
    """The content of a file, which may be a pipe or a device that never ends; messages call it `where`.

    A file that cannot be read is an `OSError`.
    """
    with path.open("rb") as file:
        content = file.read(limit.allowed + 1)
    limit.check(len(content), where)
    return content


def counts_of(component: Component, path: Location = ()) -> Iterator[tuple[Location, int, int]]:
    """The integers of an experiment and the lengths of its lists, each with its path and its default.

    A default that is missing or 0 counts as 1.
    """
    for name, field in type(component).model_fields.items():
        value, default, where = getattr(component, name), field.default, (*path, name)
        if isinstance(value, Component):
            yield from counts_of(value, where)
        elif isinstance(value, list | tuple):
            yield where, len(value), max(1, len(default) if isinstance(default, list | tuple) else 0)
        elif type(value) is int:
            yield where, value, max(1, default if type(default) is int else 0)


def memory(num_bytes: int) -> str:
    """An amount of memory, in the largest unit that gives at least 1."""
    units = ("B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB")
    power = min((num_bytes.bit_length() - 1) // 10, len(units) - 1)
    return f"{num_bytes / 1024**power:,.0f} {units[power]}"


# Measured on a CPU: the growth of the resident memory with the count.
POINTS = Limit("points", bytes_each=90_000, at_least=100_000)
"""Points of a sweep. Parking with kCBTS: settings 7 kB, module 60 kB, leaves 16 kB, plan 2 kB."""

RUNS = Limit("runs in total", bytes_each=2_000, at_least=10_000_000)
"""Runs of all points. Parking with random actions: the rows of 15 steps during merging; indices 16 B."""

CHUNKS = Limit("chunks", bytes_each=3_000, at_least=100_000)
"""Chunks of a sweep: lanes and identity 0.6 kB, folder 0.5 kB, and an entry in the manifest."""

TEXT = Limit("bytes of text", bytes_each=20, at_least=2**24)
"""Text of a table, of curves, of JSON or of a robot. Short rows of numbers: 12 B a byte, as measured."""

NUMBERS = Limit("numbers", bytes_each=16, at_least=2**24)
"""Numbers of a table: the copy in 64 bits, and the copy in the field."""

COUNT = Limit("entries or steps", bytes_each=64, at_least=10_000_000)
"""An integer of an experiment. A row of an array takes 8 B a number, and its size is computed in 32 bits."""

CELLS = Limit("grid points", bytes_each=100, at_least=1_000_000)
"""Points of a grid of a field: positions, values and interpolations."""


def square(side: int) -> int:
    """The number of points of a grid with this number on each side."""
    return side**2


LEVELS = Limit("levels", bytes_each=16_000_000, at_least=100)
"""Levels of a search tree, or layers of a network. The program has operations for each (measured)."""

FEATURES = Limit("features", bytes_each=200, at_least=1_000_000)
"""Features of a Fourier basis: the frequencies of up to about ten dimensions, as integers and numbers."""

ENTRIES = Limit("entries of a covariance", bytes_each=8, at_least=10_000_000)
"""Entries of the covariance of the weights of a linear model."""
