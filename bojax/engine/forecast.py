"""Forecast of the remaining time, from the runs that have ended and the programs still to be compiled."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass
class ChunkProgress:
    """The progress of a chunk.

    Attributes:
        lanes: Number of lanes.
        narrowest: Smallest number of lanes to which its runs can move.
        live: Number of unfinished runs in lanes.
        waiting: Number of runs that wait for a lane.
        advances_left: Upper bound of the advances of the runs in lanes.
        seconds_per_advance: Wall time of an advance of all lanes in the last segment; None before the first.
    """

    lanes: int
    narrowest: int
    live: int
    waiting: int
    advances_left: int
    seconds_per_advance: float | None = None


@dataclass
class GroupProgress:
    """The progress of a static group.

    Attributes:
        name: Name of the group.
        max_advances: Number of advances after which a run is done.
        chunks: The unfinished chunks, by index.
        seconds: Wall time of all its advances in this process.
        advances: Number of its advances in this process.
        finished: Number of runs that finished in this process.
        lane_advances: Number of advances of all its runs in this process.
        compiling_since: Time at which its compilation started; None before.
        compile_seconds: Duration of its compilation; None before its end.
        compiled: Time at which its compilation ended; None before.
        begun: Time at which its first advance began; None before.
        ended: Time at which its last segment ended; None before the first.
    """

    name: str
    max_advances: int
    chunks: dict[int, ChunkProgress] = field(default_factory=dict)
    seconds: float = 0.0
    advances: int = 0
    finished: int = 0
    lane_advances: int = 0
    compiling_since: float | None = None
    compile_seconds: float | None = None
    compiled: float | None = None
    begun: float | None = None
    ended: float | None = None

    @property
    def seconds_per_advance(self) -> float | None:
        """Mean wall time of an advance; None before the first."""
        return self.seconds / self.advances if self.advances else None

    @property
    def mean_advances(self) -> float | None:
        """Mean number of advances of a run; None if no run has ended.

        The maximum likelihood estimate for a constant rate of ending, which counts unfinished runs as well.
        """
        if not self.finished:
            return None
        return min(self.lane_advances / self.finished, float(self.max_advances))


@dataclass(frozen=True)
class Forecast:
    """The remaining time, in seconds.

    Attributes:
        compiling: Wall time of the remaining compilations.
        running: Wall time of the remaining advances.
        shares_cores: Whether compilation and advances take turns on the same cores.
    """

    compiling: float
    running: float
    shares_cores: bool

    @property
    def seconds(self) -> float:
        """Seconds until the sweep is done."""
        if self.shares_cores:
            return self.compiling + self.running
        return max(self.compiling, self.running)


def forecast(
    groups: Sequence[GroupProgress], *, now: float, workers: int, shares_cores: bool
) -> Forecast | None:
    """The remaining time; None before the first advance.

    A group without an advance is taken for an average one. While programs are compiled, an accelerator is
    taken to be idle for the same share of the time as so far: it waits for programs, and for threads that
    trace.

    Args:
        groups: All groups with unfinished chunks, and those that are done.
        now: The time.
        workers: Number of chunks that run side by side.
        shares_cores: Whether compilation and advances take turns on the same cores.
    """
    paces = [group.seconds_per_advance for group in groups if group.seconds_per_advance is not None]
    if not paces:
        return None
    shares = [group.mean_advances / group.max_advances for group in groups if group.mean_advances is not None]
    usual_pace, usual_share = float(np.mean(paces)), float(np.mean(shares)) if shares else 1.0
    running, longest = 0.0, 0.0
    for group in groups:
        mean = group.mean_advances
        mean = usual_share * group.max_advances if mean is None else mean
        for chunk in group.chunks.values():
            pace = chunk.seconds_per_advance or group.seconds_per_advance or usual_pace
            seconds = _advances_left(chunk, mean) * pace
            running, longest = running + seconds, max(longest, seconds)
    compiling = _compiling(groups, now)
    busy = _busy(groups, now, workers) if compiling and not shares_cores else 1.0
    return Forecast(compiling, max(running / workers / busy, longest), shares_cores)


def _busy(groups: Sequence[GroupProgress], now: float, workers: int) -> float:
    """Share of the time since the first advance in which the workers have advanced runs."""
    passed = now - min((group.begun for group in groups if group.begun is not None), default=now)
    seconds = sum(group.seconds for group in groups)
    return min(1.0, seconds / (passed * workers)) if passed > 0.0 < seconds else 1.0


def _advances_left(chunk: ChunkProgress, mean: float) -> float:
    """Expected number of advances of the present lanes that take as long as the chunk still takes.

    Of `n` runs that end at a constant rate, the first ends after the mean divided by `n`, and the last one
    after the mean times the harmonic number of `n`. Advances of fewer lanes take less time.
    """
    live = np.arange(1, chunk.live + 1)
    harmonic = float(np.sum(1.0 / live))
    narrowed = float(np.sum(np.maximum(live, chunk.narrowest) / live)) / chunk.lanes
    share = min(1.0, chunk.advances_left / (mean * harmonic)) if chunk.live else 0.0
    return mean * (chunk.waiting / chunk.lanes + share * min(harmonic, narrowed))


def _compiling(groups: Sequence[GroupProgress], now: float) -> float:
    """Seconds until all groups are compiled, at the pace at which compilations have ended so far."""
    starts = [group.compiling_since for group in groups if group.compiling_since is not None]
    left = sum(1 for group in groups if group.compile_seconds is None and group.chunks)
    if not starts or not left:
        return 0.0
    done = sum(
        1 for group in groups if group.compile_seconds is not None and group.compiling_since is not None
    )
    return (now - min(starts)) / max(1, done) * left
