"""Has the process send itself a signal at a chosen line of bojax, or at a chosen operation on files."""

import os
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

_TRACED = ("bojax/engine/", "bojax/results/", "bojax/numerics/checkpoint.py")
"""Where a line counts: what writes results, decides and waits."""

_FILE_EVENTS = frozenset(
    ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.listdir", "os.scandir", "shutil.rmtree")
)
"""Audit events of operations on files."""


class Counter:
    """Counts events, and acts at one of them.

    Attributes:
        count: Events so far.
    """

    def __init__(self, at: int | None, act: Callable[[], None]):
        self.count = 0
        self._at, self._act = at, act

    def tick(self) -> None:
        """Note an event."""
        if self.count == self._at:
            self.count += 1
            self._act()
        else:
            self.count += 1


def at_line(at: int | None, number: int) -> Counter:
    """Send the signal `number` before the line of bojax with this index is run; None only counts them."""
    counter = Counter(at, lambda: os.kill(os.getpid(), number))
    traced: dict[Any, bool] = {}

    def trace(frame: FrameType, event: str, argument: object) -> Any:
        del argument
        code = frame.f_code
        if event == "call":
            if code not in traced:
                traced[code] = any(part in code.co_filename for part in _TRACED)
            return trace if traced[code] else None
        if event == "line":
            counter.tick()
        return trace

    sys.settrace(trace)
    return counter


def at_file(at: int | None, number: int, folder: str) -> Counter:
    """Send the signal `number` before the operation on files in `folder` with this index is made."""
    counter = Counter(at, lambda: os.kill(os.getpid(), number))

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _FILE_EVENTS and any(folder in str(argument) for argument in arguments[:2]):
            counter.tick()

    sys.addaudithook(audit)
    return counter
