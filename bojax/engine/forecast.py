"""Forecast of the remaining time, from the runs that have ended and the programs still to be compiled."""

import heapq
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bojax.engine.clock import Clock

COMPILATION, CHUNK = 20.0, 3.0
"""Seconds of a compilation and of a chunk of which nothing is known, before any has ended."""

EXPECTED_SHARE = 0.1
"""The expected seconds of a run count as much as measurements of this share of the runs of its group."""

OWN_PACE = 1 / 3
"""The pace that a chunk has shown has a weight: the share of the chunk that is done, to this power."""

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
        seconds_per_advance: Seconds of an advance of all lanes in the last segment; None before the first.
        runs: Number of its runs; 0 if another process has begun it.
        seconds: Seconds of its advances in this process. Once it has ended on a CPU, all seconds since
            `begun`, which include those of its first state and its files.
        begun: Time when this process took it, by `time.monotonic`; None if it has not.
    """

    lanes: int
    narrowest: int
    live: int
    waiting: int
    advances_left: int
    seconds_per_advance: float | None = None
    runs: int = 0
    seconds: float = 0.0
    begun: float | None = None


@dataclass
class GroupProgress:
    """The progress of a static group.

    Attributes:
        name: Name of the group.
        max_advances: Number of advances after which a run is done.
        platform: Platform of the devices on which it runs.
        programs: Number of its programs, each for another number of lanes.
        is_timed: Whether the latency of its runs is measured at the end, with a program of its own.
        expected_compilation: Seconds that its compilation is expected to take.
        expected_run: Seconds that a run is expected to take; None if nothing tells.
        chunks: The unfinished chunks, by index.
        seconds: Seconds of all its advances in this process.
        advances: Number of its advances in this process.
        finished: Number of runs that finished in this process.
        lane_advances: Number of advances of all its runs in this process.
        ended_chunks: Number of chunks that began and ended in this process.
        ended_runs: Number of runs of these chunks.
        ended_seconds: Seconds of the advances of these chunks.
        compiling_since: Time at which its compilation started; None before.
        compile_seconds: Seconds of its compilation; None before its end.
        compiled: Time at which its compilation ended; None before.
        begun: Time at which its first advance began; None before.
        ended: Time at which its last segment ended; None before the first.
    """

    name: str
    max_advances: int
    chunks: dict[int, ChunkProgress] = field(default_factory=dict)
    platform: str = field(default="cpu", kw_only=True)
    programs: int = field(default=1, kw_only=True)
    is_timed: bool = field(default=False, kw_only=True)
    expected_compilation: float = field(default=COMPILATION, kw_only=True)
    expected_run: float | None = field(default=None, kw_only=True)
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
    def seconds_per_run(self) -> float | None:
        """Mean seconds of a run of the chunks that began and ended in this process; None before the first."""
        return self.ended_seconds / self.ended_runs if self.ended_runs else None

    @property
    def mean_advances(self) -> float:
        """Mean number of advances of a run, or the largest if no run has ended.

        The maximum likelihood estimate for a constant rate of ending, which counts unfinished runs as well.
        """
        mean = self.lane_advances / self.finished if self.finished else math.inf
        return min(mean, float(self.max_advances))

    def end(self, index: int) -> None:
        """Note that a chunk has ended or failed."""
        chunk = self.chunks.pop(index, None)
        if chunk is not None and chunk.seconds and not chunk.live + chunk.waiting:
            self.ended_chunks += 1
            self.ended_runs += chunk.runs
            self.ended_seconds += chunk.seconds if chunk.runs else 0.0


def forecast(
    groups: Sequence[GroupProgress],
    *,
    now: float,
    workers: Mapping[str, int],
    threads: int,
    clock: Clock,
) -> float | None:
    """The remaining time, s; None before the first compilation begins.

    On each platform, the groups run one after the other, each once its program is compiled. Where runs and
    compilations share the cores of a CPU, it is at least the work that is left, divided by the cores; other
    processes are taken to leave the same share of them as lately.

    Args:
        groups: All groups with unfinished chunks, and those that are done, in the order of their compilation.
        now: The time.
        workers: Number of chunks that run side by side on each platform.
        threads: Number of compilations side by side.
        clock: The clock that measured the seconds of the groups.
    """
    if all(group.compiling_since is None and not group.advances for group in groups):
        return None
    speed = _speed((each.compile_seconds, each.expected_compilation) for each in groups)
    ready, work = _compilations(groups, now, threads, clock, speed)
    seconds = max(ready, default=0.0)
    for platform, number in workers.items():
        own = [i for i, group in enumerate(groups) if group.platform == platform]
        left = dict(zip(own, _seconds_left([groups[i] for i in own]), strict=True))
        end = 0.0
        for i in sorted((i for i in own if left[i]), key=ready.__getitem__):
            end = max(end, ready[i]) + sum(left[i]) / number
            seconds = max(seconds, ready[i] + max(left[i]))
            work += sum(left[i])
        seconds = max(seconds, end)
    share = clock.share()
    timed = [speed * group.expected_compilation for group in groups if group.is_timed]
    timing = max(max(timed, default=0.0), sum(timed) / threads)
    return max(seconds / share, work / clock.cores / min(1.0, share)) + timing / share


def _compilations(
    groups: Sequence[GroupProgress], now: float, num_threads: int, clock: Clock, speed: float
) -> tuple[list[float], float]:
    """Seconds until each group is compiled, and the work that is left until then.

    When a thread has compiled all programs of a group, it goes on with the next group.
    """
    ready, threads, work = [0.0] * len(groups), [0.0] * num_threads, 0.0
    left = [i for i, group in enumerate(groups) if group.chunks and group.compile_seconds is None]
    for i in sorted(left, key=lambda i: groups[i].compiling_since is None):
        since, whole = groups[i].compiling_since, speed * groups[i].expected_compilation
        passed = 0.0 if since is None else clock.between(since, now)
        seconds, others = max(whole, LONGER * passed) - passed, (groups[i].programs - 1) * whole
        work += seconds + others
        ready[i] = threads[0] + seconds
        heapq.heapreplace(threads, ready[i] + others)
    return ready, work


def _speed(pairs: Iterable[tuple[float | None, float | None]]) -> float:
    """How many times as long as expected it takes, from pairs of measured and expected seconds.

    One more pair counts, so that a single one decides less: the mean of the expected seconds, as measured
    and as expected.
    """
    seen = [(seconds, expected) for seconds, expected in pairs if seconds is not None and expected]
    if not seen:
        return 1.0
    seconds, expected = np.sum(seen, axis=0)
    return float((seconds + expected / len(seen)) / (expected + expected / len(seen)))


def _seconds_left(groups: Sequence[GroupProgress]) -> list[list[float]]:
    """Seconds that each chunk of each group still takes on one platform.

    A chunk of a group of which nothing is known is taken to last as long as those of the other groups: their
    geometric mean, since the groups of a sweep differ by factors of up to a thousand. The pace of an advance
    says less, since an advance of one group is an episode of a robot, that of another a step of a planner.
    """
    speed = _speed((each.ended_seconds, each.ended_runs * (each.expected_run or 0.0)) for each in groups)
    left = [_known_left(group, speed) for group in groups]
    means = [
        (group.seconds + sum(chunks)) / (group.ended_chunks + len(chunks))
        for group, chunks in zip(groups, left, strict=True)
        if chunks or group.ended_chunks
    ]
    usual = float(np.exp(np.mean(np.log(np.maximum(means, 1e-3))))) if means else CHUNK
    return [chunks or [usual] * len(group.chunks) for group, chunks in zip(groups, left, strict=True)]


def _known_left(group: GroupProgress, speed: float) -> list[float]:
    """Time that each chunk of a group still takes; empty if nothing tells.

    A chunk that has begun is taken to last between what its own pace tells and what is usual for its runs:
    early episodes are often longer than late ones, and the last runs may need many more than the others. The
    further it has come, the more its own pace counts. What is usual comes from the chunks that have ended or
    begun, and also from what is expected, since the first chunks may wait for the interpreter's lock, which
    compilations hold.

    Args:
        group: The group.
        speed: How many times as long as expected runs take.
    """
    if not group.advances and group.expected_run is None:
        return []
    expected, left = speed * (group.expected_run or 0.0), []
    prior = EXPECTED_SHARE * (group.ended_runs + sum(chunk.runs for chunk in group.chunks.values()))
    runs = group.ended_runs + (prior if expected else 0.0)
    seconds = group.ended_seconds + prior * expected
    for chunk in sorted(group.chunks.values(), key=lambda chunk: not chunk.seconds):
        usual = chunk.runs * seconds / runs if runs else 0.0
        pace = chunk.seconds_per_advance or group.seconds / max(1, group.advances)
        own = chunk.seconds + _advances_left(chunk, group) * pace
        weight = (chunk.seconds / own) ** OWN_PACE if chunk.seconds else 0.0
        whole = usual ** (1.0 - weight) * own**weight if usual else own
        left.append(max(whole - chunk.seconds, weight * (own - chunk.seconds)))
        if chunk.runs:
            runs, seconds = runs + chunk.runs, seconds + whole
    return left


def _advances_left(chunk: ChunkProgress, group: GroupProgress) -> float:
    """Expected number of advances of the present lanes that take as long as the chunk still takes.

    Of `n` runs that end at a constant rate, the first ends after the mean divided by `n`, and the last one
    after the mean times the harmonic number of `n`. Advances of fewer lanes take less time. Runs of equal
    length, or of which none has ended, pass through the lanes in rounds.
    """
    mean, rounds = group.mean_advances, chunk.waiting / chunk.lanes
    if mean == group.max_advances:
        rounds = math.ceil(rounds)
    live = np.arange(1, chunk.live + 1)
    harmonic = float(np.sum(1.0 / live))
    narrowed = float(np.sum(np.maximum(live, chunk.narrowest) / live)) / chunk.lanes
    share = min(1.0, chunk.advances_left / (mean * harmonic)) if chunk.live else 0.0
    return mean * (rounds + share * min(harmonic, narrowed))
