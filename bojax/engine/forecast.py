"""Forecast of the remaining time, from the runs that have ended and the programs still to be compiled."""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

COMPILATION, CHUNK = 20.0, 3.0
"""Seconds of a compilation and of a chunk before any has ended: about the medians on an H200."""

LONGER = 1.3
"""A compilation that lasts longer than usual is taken to last so many times as long as it has lasted."""


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
        remembered: Wall time of a run in an earlier sweep, as far as it is known.
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
    remembered: float | None = field(default=None, kw_only=True)
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
        compiling: Seconds until all programs are compiled.
        seconds: Seconds until the sweep is done.
    """

    compiling: float
    seconds: float


def forecast(groups: Sequence[GroupProgress], *, now: float, workers: Mapping[str, int]) -> Forecast | None:
    """The remaining time; None before the first compilation begins.

    On each platform, the groups run one after the other, each once its program is compiled. Where runs and
    compilations share the cores of a CPU, both are as slow as so far.

    Args:
        groups: All groups with unfinished chunks, and those that are done, in the order of their compilation.
        now: The time.
        workers: Number of chunks that run side by side on each platform.
    """
    if all(group.compiling_since is None and not group.advances for group in groups):
        return None
    ready, seconds = _ready(groups, now), 0.0
    for platform, number in workers.items():
        own = [i for i, group in enumerate(groups) if group.platform == platform]
        left = dict(zip(own, _seconds_left([groups[i] for i in own]), strict=True))
        end = 0.0
        for i in sorted((i for i in own if left[i]), key=ready.__getitem__):
            end = max(end, ready[i]) + sum(left[i]) / number
            seconds = max(seconds, ready[i] + max(left[i]))
        seconds = max(seconds, end)
    return Forecast(max(ready, default=0.0), seconds)


def _ready(groups: Sequence[GroupProgress], now: float) -> list[float]:
    """Seconds until each group is compiled.

    A compilation lasts as long as others on average, and the next one begins when one ends.
    """
    ended = [
        group.compiled - group.compiling_since
        for group in groups
        if group.compiled is not None and group.compiling_since is not None
    ]
    usual = (COMPILATION + sum(ended)) / (1 + len(ended))
    ready, threads = [0.0] * len(groups), []
    left = [i for i, group in enumerate(groups) if group.chunks and group.compile_seconds is None]
    for i in sorted(left, key=lambda i: groups[i].compiling_since is None):
        since = groups[i].compiling_since
        if since is None:
            ready[i] = (heapq.heappop(threads) if threads else 0.0) + usual
        else:
            ready[i] = max(usual, LONGER * (now - since)) - (now - since)
        heapq.heappush(threads, ready[i])
    return ready


def _seconds_left(groups: Sequence[GroupProgress]) -> list[list[float]]:
    """Time that each chunk of each group still takes on one platform.

    A chunk of a group of which nothing is known is taken to last as long as those of the other groups: their
    geometric mean, since the groups of a sweep differ by factors of up to a thousand. The pace of an advance
    says less, since an advance of one group is an episode of a robot, that of another a step of a planner.
    """
    shares = [group.mean_advances / group.max_advances for group in groups if group.mean_advances is not None]
    before = [(group, group.remembered) for group in groups if group.remembered is not None]
    ahead = sum(chunk.runs * each for group, each in before for chunk in group.chunks.values())
    ended = sum(group.ended_runs * each for group, each in before)
    took = sum(group.ended_seconds for group, _ in before if group.ended_runs)
    speed = (took + ahead) / (ended + ahead) if ended + ahead else 1.0
    left = [_known_left(group, float(np.mean(shares)) if shares else 1.0, speed) for group in groups]
    means = [
        (group.seconds + sum(chunks)) / (group.ended_chunks + len(chunks))
        for group, chunks in zip(groups, left, strict=True)
        if chunks or group.ended_chunks
    ]
    usual = float(np.exp(np.mean(np.log(np.maximum(means, 1e-3))))) if means else CHUNK
    return [chunks or [usual] * len(group.chunks) for group, chunks in zip(groups, left, strict=True)]


def _known_left(group: GroupProgress, usual_share: float, speed: float) -> list[float]:
    """Time that each chunk of a group still takes; empty if nothing tells.

    The chunks are taken to need as long for each run as those that have ended, or as in an earlier sweep:
    early episodes are often longer than late ones, and the last runs may need many more than the others. The
    further a chunk has come, the more its own pace counts.

    Args:
        group: The group.
        usual_share: Mean number of advances of a run, as a share of the most, if no run has ended.
        speed: How many times as long as in earlier sweeps runs take; the fewer of them have ended, the
            closer to 1.
    """
    if not group.advances and group.remembered is None:
        return []
    mean = usual_share * group.max_advances if group.mean_advances is None else group.mean_advances
    per_run = speed * (group.remembered or 0.0)
    if group.ended_runs:
        per_run = group.ended_seconds / group.ended_runs
    left = []
    for chunk in group.chunks.values():
        whole, pace = chunk.runs * per_run, chunk.seconds_per_advance or group.seconds_per_advance or 0.0
        share = min(1.0, chunk.seconds / whole) if whole else 1.0
        seconds = (1.0 - share) * (whole - chunk.seconds) + share * _advances_left(chunk, mean) * pace
        left.append(seconds)
    return left


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
