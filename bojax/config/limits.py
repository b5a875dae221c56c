"""Limits on the size of what is asked for, derived from the memory that it takes."""

import os
from dataclasses import dataclass
from pathlib import Path

from bojax.config.errors import ConfigError


@dataclass(frozen=True)
class Limit:
    """A limit on a count: as many as fit into half the memory of the machine.

    Attributes:
        name: Noun for messages.
        bytes_each: Memory per item, in bytes.
        at_least: Lower bound of the limit on any machine.
    """

    name: str
    bytes_each: int
    at_least: int

    @property
    def allowed(self) -> int:
        """The largest number accepted on this machine."""
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return max(self.at_least, memory // 2 // self.bytes_each)

    def check(self, number: int, where: str) -> None:
        """Refuse a number above the limit.

        Raises:
            ConfigError: The number is above the limit; `where` names the setting.
        """
        if number > self.allowed:
            raise ConfigError(
                f"{where}: got {number:,} {self.name}, which take about {_memory(number * self.bytes_each)} "
                f"of memory; allowed: at most {self.allowed:,}"
            )


def read_within(limit: Limit, path: Path, where: str) -> bytes:
    """The content of a file, which may be a pipe or a device that never ends.

    Raises:
        ConfigError: The content is longer than the limit; `where` names the file.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(limit.allowed + 1)
    limit.check(len(content), where)
    return content


def _memory(num_bytes: int) -> str:
    """An amount of memory in the largest unit in which it is at least 1."""
    units = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")
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
"""Numbers of a table: the copy in 64 bits, and that of the field."""
