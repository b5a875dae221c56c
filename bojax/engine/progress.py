"""Progress of a sweep: a live bar in a terminal, otherwise a plain line every few seconds."""

import time
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from bojax.config.errors import printable

LINE_SECONDS = 10.0
"""Minimum time between two plain lines."""


class SweepProgress:
    """Reports the progress of a sweep: runs done, steps per second, lane utilisation, time left, compilation.

    Args:
        title: Name of the sweep.
        num_lanes: Number of real lanes of the whole sweep.
        console: Console to write to; standard error by default.
    """

    def __init__(self, title: str, num_lanes: int, console: Console | None = None):
        self._console = console or Console(stderr=True, highlight=False)
        self._title = title
        self._num_lanes = num_lanes
        self._work_before = 0.0  # done by earlier processes; not part of the pace of this one
        self._lanes_done = 0
        self._chunk_lanes, self._chunk_share, self._chunk_runs = 0, 0.0, 0
        self._steps, self._seconds = 0, 0.0
        self._busy, self._issued = 0, 0
        self._last_line = time.monotonic()
        self._bar: Progress | None = None

    def __enter__(self) -> "SweepProgress":
        if self._console.is_terminal:
            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24))
            texts = (TextColumn("{task.fields[text]}"), TimeElapsedColumn())
            self._bar = Progress(*columns, *texts, console=self._console)
            self._task = self._bar.add_task(escape(self._title), total=self._num_lanes, text="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def say(self, text: str) -> None:
        """Print a line that stays on the screen."""
        self._console.print(escape(printable(text)), soft_wrap=True)

    def compiling(self, what: str) -> None:
        """Report that a compilation has started."""
        self._set_text(f"compiling {what} ...")

    def compiled(self, what: str, seconds: float) -> None:
        """Report that a compilation has ended."""
        self.say(f"compiled {what} in {seconds:.1f} s")

    def timing(self, what: str) -> None:
        """Report that a single run is being compiled and timed."""
        self._set_text(f"timing a single run of {what} ...")

    def skip(self, lanes: int) -> None:
        """Count lanes that an earlier process finished."""
        self._work_before += lanes
        self._lanes_done += lanes
        self._show()

    def start_chunk(self, lanes: int, share: float) -> None:
        """Report that a chunk starts, or resumes after this share of its advances."""
        self._chunk_lanes, self._chunk_share, self._chunk_runs = lanes, share, 0
        self._work_before += lanes * share

    def segment(self, *, share: float, runs: int, steps: int, seconds: float, busy: int, issued: int) -> None:
        """Report that a segment has ended.

        Args:
            share: Share of the chunk's advances made so far.
            runs: Number of runs of the chunk that are done.
            steps: Number of environment steps in the segment.
            seconds: Duration of the segment.
            busy: Number of (lane, advance) pairs of the segment in which the lane was active.
            issued: Number of all (lane, advance) pairs of the segment, including padding.
        """
        self._chunk_share, self._chunk_runs = share, runs
        self._steps += steps
        self._seconds += seconds
        self._busy += busy
        self._issued += issued
        self._show()

    def end_chunk(self) -> None:
        """Report that all lanes of the chunk are done."""
        self._lanes_done += self._chunk_lanes
        self._chunk_lanes, self._chunk_share, self._chunk_runs = 0, 0.0, 0
        self._show()

    def describe(self) -> str:
        """The progress of the sweep in one line."""
        runs = self._lanes_done + self._chunk_runs
        rate = self._steps / self._seconds if self._seconds else 0.0
        utilisation = self._busy / self._issued if self._issued else 1.0
        text = f"{runs}/{self._num_lanes} runs, {_si(rate)} steps/s, lanes {utilisation:.0%} busy"
        left = self._time_left()
        return text if left is None else f"{text}, {_duration(left)} left"

    def _work(self) -> float:
        return self._lanes_done + self._chunk_lanes * self._chunk_share

    def _time_left(self) -> float | None:
        """Seconds left at the pace so far, without compilation; an upper bound if lanes finish early."""
        done = self._work() - self._work_before
        if done <= 0 or not self._seconds:
            return None
        return self._seconds / done * (self._num_lanes - self._work())

    def _show(self) -> None:
        if self._bar is not None:
            self._bar.update(self._task, completed=self._work(), text=escape(self.describe()))
        elif time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(f"{self._title}: {self.describe()}")

    def _set_text(self, text: str) -> None:
        if self._bar is not None:
            self._bar.update(self._task, text=escape(text))
        else:
            self.say(text)


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"


def _si(value: float) -> str:
    for limit, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= limit:
            return f"{value / limit:.3g}{suffix}"
    return f"{value:.3g}"
