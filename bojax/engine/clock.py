"""Time as the threads of this process get it, which is less than that of the wall where cores are shared."""

import math
import time
from bisect import bisect_left

from bojax.numerics.cores import usable_cores

RECENT_SECONDS = 10.0
"""The share of the cores is that of the last seconds of this number, or of the last half of the time."""

MOST_MARKS = 4096
"""Number of moments that a clock keeps; beyond it, every second one is dropped."""


class Clock:
    """Seconds that a busy thread of this process gets.

    On the cores of a CPU, they are the processor time of the process divided by the number of its busy
    threads, so that what work takes does not depend on what else the machine does. Otherwise they are those
    of the wall.

    Attributes:
        cores: Number of cores that threads share; infinite if they wait for something else.

    Args:
        shares_cores: Whether all work is done by the cores of this process.
    """

    def __init__(self, *, shares_cores: bool = False):
        self.cores = usable_cores() if shares_cores else math.inf
        # Of each moment: time, processor time, seconds that a thread got, and those that all cores offered.
        self._marks = [(time.monotonic(), time.process_time(), 0.0, 0.0)]

    def note(self, busy: int) -> None:
        """Note that so many threads were busy since the last note."""
        before, used, got, could = self._marks[-1]
        now, using, busy = time.monotonic(), time.process_time(), max(1, busy)
        if self.cores == math.inf or now == before:
            return
        got, could = got + (using - used) / busy, could + (now - before) * min(busy, self.cores)
        self._marks.append((now, using, got, could))
        if len(self._marks) > MOST_MARKS:
            del self._marks[1:-1:2]

    def between(self, start: float, end: float) -> float:
        """Seconds that a busy thread got between two moments."""
        return self._got(end) - self._got(start)

    def share(self) -> float:
        """Cores that each busy thread lately got: less than 1 on a busy machine, more if XLA uses several."""
        (first, *_), (now, used, _, could) = self._marks[0], self._marks[-1]
        since = bisect_left(self._marks, (now - max(RECENT_SECONDS, (now - first) / 2),))
        _, used_before, _, could_before = self._marks[since]
        seconds = could - could_before
        return max(0.01, (used - used_before) / seconds) if seconds else 1.0

    def _got(self, moment: float) -> float:
        if len(self._marks) == 1:
            return moment
        i = max(1, min(bisect_left(self._marks, (moment,)), len(self._marks) - 1))
        (before, _, got, _), (after, _, more, _) = self._marks[i - 1 : i + 1]
        return got + (more - got) * (moment - before) / (after - before)
