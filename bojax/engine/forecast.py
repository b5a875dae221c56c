"""Forecast of the remaining time, from the runs that have ended and the programs still to be compiled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bojax.engine.devices import of_platform

NEARLY = 0.9
"""Largest share for which a compilation counts before its end."""


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
        runs: Number of its runs; 0 if another process has begun it.
        seconds: Wall time of its advances in this process.
    """

    lanes: int
    narrowest: int
    live: int
    waiting: int
    advances_left: int
    seconds_per_advance: float | None = None
    runs: int = 0
    seconds: float = 0.0


@dataclass
class GroupProgress:
    """The progress of a static group.

    Attributes:
        name: Name of the group.
        max_advances: Number of advances after which a run is done.
        platform: Platform of the devices on which it runs.
        chunks: The unfinished chunks, by index.
        seconds: Wall time of all its advances in this process.
        advances: Number of its advances in this process.
        finished: Number of runs that finished in this process.
        lane_advances: Number of advances of all its runs in this process.
        ended_chunks: Number of chunks that began and ended in this process.
        ended_runs: Number of runs of these chunks.
        ended_seconds: Wall time of the advances of these chunks.
        compiling_since: Time at which its compilation started; None before.
        compile_seconds: Duration of its compilation; None before its end.
        compiled: Time at which its compilation ended; None before.
        begun: Time at which its first advance began; None before.
        ended: Time at which its last segment ended; None before the first.
    """

    name: str
    max_advances: int
    chunks: dict[int, ChunkProgress] = field(default_factory=dict)
    platform: str = field(default="cpu", kw_only=True)
    seconds: float = 0.0
    advances: int = 0
    finished: int = 0
    lane_advances: int = 0
    ended_chunks: int = 0
    ended_runs: int = 0
    ended_seconds: float = 0.0
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

    def end(self, index: int) -> None:
        """Note that a chunk has ended or failed."""
        chunk = self.chunks.pop(index, None)
        if chunk is not None and chunk.seconds and not chunk.live + chunk.waiting:
            self.ended_chunks += 1
            self.ended_runs += chunk.runs
            self.ended_seconds += chunk.seconds if chunk.runs else 0.0


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


def forecast(groups: Sequence[GroupProgress], *, now: float, workers: Mapping[str, int]) -> Forecast | None:
    """The remaining time; None before the first advance.

    The time of the advances is that of the platform that takes longest. If there is only the CPU, it also
    compiles. Otherwise, while programs are compiled, devices are taken to be idle for the same share of the
    time as so far: they wait for programs, and for threads that trace.

    Args:
        groups: All groups with unfinished chunks, and those that are done.
        now: The time.
        workers: Number of chunks that run side by side on each platform.
    """
    if not any(group.advances for group in groups):
        return None
    compiling, shares_cores = _compiling(groups, now), set(workers) <= {"cpu"}
    running = 0.0
    for platform, number in workers.items():
        own = of_platform(groups, platform)
        busy = _busy(own, now, number) if compiling and not shares_cores else 1.0
        running = max(running, _running(own, number, busy))
    return Forecast(compiling, running, shares_cores)


def _running(groups: Sequence[GroupProgress], workers: int, busy: float) -> float:
    """Wall time of the remaining advances on one platform; 0 before the first advance there.

    Once a chunk of a group has ended, the others are taken to need as long for each run: early episodes are
    often longer than late ones. The chunks of a group without an advance are taken to need as long as those
    of other groups on average. The pace of an advance says less: an advance of one group is an episode of a
    robot, that of another a step of a planner.

    Args:
        groups: The groups that run there.
        workers: Number of chunks that run side by side.
        busy: Share of the time in which the workers advance runs.
    """
    known = [group for group in groups if group.advances]
    if not known:
        return 0.0
    shares = [group.mean_advances / group.max_advances for group in known if group.mean_advances is not None]
    usual_share = float(np.mean(shares)) if shares else 1.0
    left = [seconds for group in known for seconds in _seconds_left(group, usual_share)]
    whole = sum(group.seconds for group in known) + sum(left)
    usual = whole / max(1, sum(group.ended_chunks for group in known) + len(left))
    left += [usual for group in groups if not group.advances for _ in group.chunks]
    return max(sum(left) / workers / busy, max(left, default=0.0))


def _seconds_left(group: GroupProgress, usual_share: float) -> list[float]:
    """Time that each chunk of a group still takes.

    Args:
        group: A group with an advance.
        usual_share: Mean number of advances of a run, as a share of the most, if no run has ended.
    """
    mean = usual_share * group.max_advances if group.mean_advances is None else group.mean_advances
    left = []
    for chunk in group.chunks.values():
        whole = chunk.runs * group.ended_seconds / max(1, group.ended_runs)
        seconds = whole - chunk.seconds  # if it takes as long as those that have ended
        if seconds <= 0.0:
            pace = chunk.seconds_per_advance or group.seconds_per_advance or 0.0
            seconds = _advances_left(chunk, mean) * pace
        left.append(seconds)
    return left


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
    """Seconds until all groups are compiled, at the pace of the compilations so far.

    One that has begun counts by its share of the usual duration, but never as done.
    """
    left = [group for group in groups if group.compile_seconds is None and group.chunks]
    begun = [group.compiling_since for group in groups if group.compiling_since is not None]
    if not begun or not left:
        return 0.0
    ended = [
        group.compiled - group.compiling_since
        for group in groups
        if group.compiled is not None and group.compiling_since is not None
    ]
    usual = max(float(np.mean(ended)), 1e-9) if ended else np.inf
    ages = [now - group.compiling_since for group in left if group.compiling_since is not None]
    parts = sum(min(age / usual, NEARLY) for age in ages)
    return (now - min(begun)) / max(1.0, len(ended) + parts) * (len(left) - parts)
