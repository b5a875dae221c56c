"""The largest sizes of a sweep that are accepted, each by the memory that it takes."""

import os
from dataclasses import dataclass

from bojax.config.errors import ConfigError


@dataclass(frozen=True)
class Limit:
    """How many of something half the machine's memory holds.

    Attributes:
        name: What is counted.
        bytes_each: Memory that one of them takes.
        at_least: This many are accepted on any machine.
    """

    name: str
    bytes_each: int
    at_least: int

    @property
    def allowed(self) -> int:
        """The largest number that is accepted here."""
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return max(self.at_least, memory // 2 // self.bytes_each)

    def check(self, number: int, where: str) -> None:
        """Refuse a number above the limit.

        Raises:
            ConfigError: It is; `where` names the setting.
        """
        if number > self.allowed:
            raise ConfigError(
                f"{where}: got {number:,} {self.name}, which take some {_in_words(number * self.bytes_each)} "
                f"of memory; allowed: at most {self.allowed:,}"
            )


def _in_words(num_bytes: int) -> str:
    """An amount of memory, in the largest unit of which there is at least one."""
    units = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")
    power = min((num_bytes.bit_length() - 1) // 10, len(units) - 1)
    return f"{num_bytes / 1024**power:,.0f} {units[power]}"


# Measured on a CPU, as the growth of the resident memory with the number.
POINTS = Limit("points", bytes_each=90_000, at_least=100_000)
"""Of a sweep. Parking with kCBTS: 7 kB of settings, 60 kB of the module, 16 kB of leaves, 2 kB of plan."""

RUNS = Limit("runs, of all points", bytes_each=2_000, at_least=10_000_000)
"""Of all points. Parking with random actions: rows of 15 steps while tables are merged; 16 B of indices."""

CHUNKS = Limit("chunks", bytes_each=3_000, at_least=100_000)
"""Of a sweep: 0.6 kB of lanes and identity, 0.5 kB of its folder, and its entry of the manifest."""
