"""Progress of sweeps: runs done, speed and time left, in one line."""

import threading
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from types import MappingProxyType, TracebackType

from rich.console import Console

from bojax.engine.bar import Bar
from bojax.engine.clock import Clock
from bojax.engine.forecast import GroupProgress, forecast
from bojax.engine.runner import Segment
from bojax.text import duration

RECENT_SECONDS = 10.0
"""Time over which the pace is averaged."""

TICK_SECONDS = 2.0
"""Time after which the progress is shown again if nothing has happened."""


class SweepProgress:
    """Reports the progress of sweeps: runs done, steps per second, lane utilisation, compilation, time left.

    Its methods may be called from any thread.

    Args:
        title: Name of the sweep.
        num_runs: Number of runs of the whole sweep.
        workers: Number of chunks that run side by side on each platform.
        threads: Number of compilations side by side.
        clock: Measures what compilations and chunks take.
        console: Console to write to; standard error by default.
    """

    def __init__(
        self,
        title: str,
        num_runs: int,
        *,
        workers: Mapping[str, int] = MappingProxyType({"cpu": 1}),
        threads: int = 1,
        clock: Clock | None = None,
        console: Console | None = None,
    ):
        self._bar = Bar(title, num_runs, console or Console(stderr=True, highlight=False))
        self._num_runs = num_runs
        self._workers, self._threads = workers, threads
        self._clock = clock or Clock()
        self._advanced = defaultdict(float)  # wall time of segments, by platform
        self._start = self._shown = time.monotonic()
        self._groups: list[GroupProgress] = []
        self._runs_done = 0
        self._steps = self._issued = 0
        self._recent: list[tuple[float, float, int]] = []  # start, end and steps of segments
        self._lock = threading.RLock()

    def __enter__(self) -> "SweepProgress":
        self._bar.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.__exit__(kind, error, trace)

    def say(self, text: str) -> None:
        """Print a line that stays on the screen."""
        with self._lock:
            self._bar.say(text)

    def add(self, groups: Sequence[GroupProgress], runs_done: int = 0) -> None:
        """Add groups that have unfinished chunks, and count runs that earlier processes finished."""
        with self._lock:
            self._groups += groups
            self._runs_done += runs_done

    def compiling(self, group: GroupProgress) -> None:
        """Report that the compilation of a group has started."""
        with self._lock:
            self._note()
            group.compiling_since = time.monotonic()
            if not self._bar.is_live:
                self.say(f"compiling {group.name} ...")
            self._show()

    def compiled(self, group: GroupProgress, seconds: float) -> None:
        """Report that the compilation of a group has ended."""
        with self._lock:
            self._note()
            group.compiled = time.monotonic()
            group.compile_seconds = self._clock.between(group.compiled - seconds, group.compiled)
            self.say(f"compiled {group.name} in {seconds:.1f} s")
            self._show()

    def timing(self, what: str) -> None:
        """Report that a single run is being timed."""
        self.say(f"timing a single run of {what} ...")

    def segment(self, group: GroupProgress, chunk: int, segment: Segment) -> None:
        """Report that a segment of a chunk has ended."""
        with self._lock:
            self._note()
            now = group.ended = time.monotonic()
            start = now - segment.seconds
            seconds = self._clock.between(start, now)
            self._advanced[group.platform] += segment.seconds
            group.finished += segment.finished
            group.lane_advances += segment.lane_advances
            group.seconds += seconds
            group.advances += segment.advances
            state = group.chunks[chunk]
            state.lanes, state.live, state.waiting = segment.lanes, segment.live, segment.waiting
            state.advances_left = segment.advances_left
            state.seconds_per_advance = seconds / max(1, segment.advances)
            state.seconds += seconds
            self._runs_done += segment.finished
            self._steps += segment.active_steps
            self._issued += segment.issued_steps
            if group.begun is None:
                group.begun = start
            self._recent.append((start, now, segment.active_steps))
            self._show()

    def end_chunk(self, group: GroupProgress, chunk: int) -> None:
        """Report that a chunk has ended or failed."""
        with self._lock:
            self._note()
            state = group.chunks.get(chunk)
            if state is not None and state.begun is not None and group.platform == "cpu":
                state.seconds = self._clock.between(state.begun, time.monotonic())
            group.end(chunk)

    def tick(self) -> None:
        """Show the progress if it has not been shown for a while: the time left changes meanwhile."""
        with self._lock:
            self._note()
            if time.monotonic() - self._shown >= TICK_SECONDS:
                self._show()

    def describe(self) -> str:
        """The progress in one line, of which a narrow terminal cuts the end."""
        busy = self._steps / self._issued if self._issued else 1.0
        text = f"{self._runs_done}/{self._num_runs} runs"
        if (left := self.seconds_left()) is not None:
            text += f", {duration(left)} left"
        if rate := self._rate():
            text += f", {_si(rate)} steps/s, lanes {busy:.0%} busy"
        compiling = sum(1 for group in self._groups if group.chunks and group.compile_seconds is None)
        if compiling:
            text += f", {compiling} of {len(self._groups)} programs to compile"
        return text

    def seconds_left(self) -> float | None:
        """Forecast of the time left, s; None if nothing tells."""
        return forecast(
            self._groups,
            now=time.monotonic(),
            workers=self._workers,
            threads=self._threads,
            clock=self._clock,
        )

    def describe_times(self) -> str:
        """In one line, where the time has gone since the first group was added."""
        with self._lock:
            passed = max(time.monotonic() - self._start, 1e-9)
            ends = [group.compiled for group in self._groups if group.compiled is not None]
            compiled = "no group was ready"
            if ends:
                compiled = f"the last group was ready after {duration(max(ends) - self._start)}"
            busy = []
            for platform, number in self._workers.items():
                seconds = self._advanced[platform]
                where = f"on the {platform} " if len(self._workers) > 1 else ""
                busy.append(f"{where}{seconds / (passed * number):.0%} of the time")
            return f"ran for {duration(passed)}: {compiled}, runs advanced {', '.join(busy)}"

    def _note(self) -> None:
        """Note how many threads were busy: with compilations, or with chunks whose programs are there."""
        waiting = [group for group in self._groups if group.compile_seconds is None]
        compiling = sum(1 for group in waiting if group.compiling_since is not None)
        ready = sum(len(group.chunks) for group in self._groups if group.compile_seconds is not None)
        self._clock.note(compiling + min(ready, sum(self._workers.values())))

    def _rate(self) -> float:
        """Steps per second of the last segments."""
        now = time.monotonic()
        self._recent = [segment for segment in self._recent if now - segment[1] <= RECENT_SECONDS]
        passed = now - min((start for start, _, _ in self._recent), default=now)
        return sum(steps for _, _, steps in self._recent) / passed if passed else 0.0

    def _show(self) -> None:
        self._shown = time.monotonic()
        self._bar.show(self._runs_done, self.describe())


def _si(value: float) -> str:
    for limit, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= limit:
            return f"{value / limit:.3g}{suffix}"
    return f"{value:.3g}"
