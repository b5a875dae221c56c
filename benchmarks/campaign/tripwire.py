"""Has the process send itself a signal at a chosen line of bojax, or at a chosen operation on files."""

import functools
import os
import sys
from types import CodeType, FrameType
from typing import Any

_TRACED = ("bojax/engine/", "bojax/results/", "bojax/numerics/checkpoint.py")
"""Where a line counts: what writes results, decides and waits."""

_FILE_EVENTS = frozenset(
    ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.listdir", "os.scandir", "shutil.rmtree")
)
"""Audit events of operations on files."""


class Counter:
    """Counts events, and sends this process a signal before one of them.

    Attributes:
        count: Events so far.
    """

    def __init__(self, at: int | None, number: int):
        self.count = 0
        self._at, self._number = at, number

    def tick(self) -> None:
        """Note an event."""
        self.count += 1
        if self.count - 1 == self._at:
            os.kill(os.getpid(), self._number)


def at_line(at: int | None, number: int, folder: str) -> Counter:
    """Send the signal `number` before the line of bojax with this index is run; None only counts them."""
    del folder
    counter = Counter(at, number)

    @functools.cache
    def is_traced(code: CodeType) -> bool:
        return any(part in code.co_filename for part in _TRACED)

    def trace(frame: FrameType, event: str, argument: object) -> Any:
        del argument
        if event == "call":
            return trace if is_traced(frame.f_code) else None
        if event == "line":
            counter.tick()
        return trace

    sys.settrace(trace)
    return counter


def at_file(at: int | None, number: int, folder: str) -> Counter:
    """Send the signal `number` before the operation on files in `folder` with this index is made."""
    counter = Counter(at, number)

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _FILE_EVENTS and any(folder in str(argument) for argument in arguments[:2]):
            counter.tick()

    sys.addaudithook(audit)
    return counter
