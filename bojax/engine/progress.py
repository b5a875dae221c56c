"""Progress of sweeps: runs done, speed and time left, in one line."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console

from bojax.engine.bar import Bar
from bojax.engine.runner import Segment
from bojax.text import duration

RECENT_SECONDS = 10.0
"""Time over which the steps per second are averaged."""

TICK_SECONDS = 2.0
"""Time after which the progress is shown again if nothing has happened."""


STILL_SECONDS, STILL_FACTOR = 300.0, 10.0
"""Time without a segment after which a note says so; it is also this factor times the longest segment."""


_ADVICE = "if the device hangs, press Ctrl-C twice, and go on with --resume"


@dataclass(eq=False)
class GroupProgress:
    """When a static group was compiled and run by this process, by `time.monotonic`; None before."""

    name: str
    compiling: float | None = None  # when its compilation began
    compiled: float | None = None  # when its compilation ended
    begun: float | None = None  # when its first segment began
    ended: float | None = None  # when its last segment ended
    has_failed: bool = False  # whether its programs or some of its runs have failed


class SweepProgress:
    """Reports the progress of sweeps: runs done, steps per second, lane utilisation, compilation, time left.

    Its methods may be called from any thread.
    """

    def __init__(self, title: str, num_runs: int, *, console: Console | None = None):
        self._bar = Bar(title, num_runs, console or Console(stderr=True, highlight=False))
        self._num_runs = num_runs
        self._groups: list[GroupProgress] = []
        self._earlier = self._finished = self._failed = 0  # runs of earlier processes and of this one
        self._steps = self._issued = 0
        self._recent: list[tuple[float, float, int]] = []  # start, end and steps of segments
        self._shown = time.monotonic()
        self._moved: float | None = None  # end of the last segment; None once it was said to be long ago
        self._longest = 0.0  # seconds of the longest segment
        self._lock = threading.RLock()

    def __enter__(self) -> "SweepProgress":
        self._bar.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.__exit__()

    def say(self, text: str) -> None:
        """Print a line that stays on the screen."""
        with self._lock:
            self._bar.say(text)

    def add(self, groups: Sequence[GroupProgress], runs_done: int = 0) -> None:
        """Add groups that have unfinished chunks, and count runs that other processes finished."""
        with self._lock:
            self._groups += groups
            self._earlier += runs_done

    def compiling(self, group: GroupProgress) -> None:
        """Report that the compilation of a group has started."""
        with self._lock:
            group.compiling = time.monotonic()
            if not self._bar.is_live:
                self.say(f"compiling {group.name} ...")
            self._show()

    def compiled(self, group: GroupProgress, seconds: float) -> None:
        """Report that the compilation of a group has ended."""
        with self._lock:
            group.compiled = time.monotonic()
            self.say(f"compiled {group.name} in {seconds:.1f} s")
            self._show()

    def segment(self, group: GroupProgress, segment: Segment) -> None:
        """Report that a segment of a chunk has ended."""
        with self._lock:
            group.ended = now = time.monotonic()
            start = now - segment.seconds
            if group.begun is None:
                group.begun = start
            self._finished += segment.finished
            self._steps += segment.active_steps
            self._issued += segment.issued_steps
            self._recent.append((start, now, segment.active_steps))
            self._moved, self._longest = now, max(self._longest, segment.seconds)
            self._show()

    def failed(self, group: GroupProgress, num_runs: int, reason: str) -> None:
        """Report that runs of a group have failed."""
        with self._lock:
            group.has_failed = True
            self._failed += num_runs
            self.say(f"failed: {group.name}, {num_runs} run{'s' if num_runs > 1 else ''}: {reason}")

    def tick(self) -> None:
        """Show the progress if it has not been shown for a while: the time left changes meanwhile.

        If no run has advanced for long, it also says how to end a sweep whose device hangs.
        """
        with self._lock:
            still = 0.0 if self._moved is None else time.monotonic() - self._moved
            if still > max(STILL_SECONDS, STILL_FACTOR * self._longest):
                self._moved = None
                self.say(f"note: no run has advanced for {duration(still)}; {_ADVICE}")
            if time.monotonic() - self._shown >= TICK_SECONDS:
                self._show()

    def describe(self) -> str:
        """The progress in one line; a narrow terminal cuts off its end."""
        busy = self._steps / self._issued if self._issued else 1.0
        text = f"{self._earlier + self._finished}/{self._num_runs} runs"
        if (left := self.seconds_left()) is not None:
            text += f", {duration(left)} left"
        if rate := self._rate():
            text += f", {_si(rate)} steps/s, lanes {busy:.0%} busy"
        if waiting := len(self._to_compile()):
            text += f", {waiting} of {len(self._groups)} programs to compile"
        return text

    def seconds_left(self) -> float | None:
        """Estimate of the time left, s; None before a run has ended in this process.

        The larger of two estimates, each at the mean pace of this process so far:

            runs left * (time since the first run began) / (runs that ended here)
            programs left * (time since the first compilation began) / (programs compiled here)

        Runs of earlier processes are neither left nor a measure of the pace, and failed runs are not left.
        The estimate is wrong to the extent that the runs or programs left differ from those that have ended.
        """
        if not self._finished:
            return None
        now, done = time.monotonic(), self._earlier + self._finished
        left = max(0, self._num_runs - done - self._failed)
        begun = min((each.begun for each in self._groups if each.begun is not None), default=now)
        estimate = left * (now - begun) / self._finished
        since = min((each.compiling for each in self._groups if each.compiling is not None), default=now)
        if compiled := sum(1 for group in self._groups if group.compiled is not None):
            estimate = max(estimate, len(self._to_compile()) * (now - since) / compiled)
        return estimate

    def _to_compile(self) -> list[GroupProgress]:
        return [group for group in self._groups if group.compiled is None and not group.has_failed]

    def _rate(self) -> float:
        """Steps per second of the last segments."""
        now = time.monotonic()
        self._recent = [segment for segment in self._recent if now - segment[1] <= RECENT_SECONDS]
        passed = now - min((start for start, _, _ in self._recent), default=now)
        return sum(steps for _, _, steps in self._recent) / passed if passed else 0.0

    def _show(self) -> None:
        self._shown = time.monotonic()
        self._bar.show(self._earlier + self._finished, self.describe())


def _si(value: float) -> str:
    for limit, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= limit:
            return f"{value / limit:.3g}{suffix}"
    return f"{value:.3g}"
