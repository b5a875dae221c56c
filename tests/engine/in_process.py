"""A launcher that runs a worker in the process of the driver."""

from collections.abc import Callable, Sequence
from pathlib import Path

from bojax.engine.remote import Launcher


class InProcessLauncher(Launcher):
    """Calls a function with the results folders, in place of a worker.

    Args:
        work: Runs the chunks, and returns the exit code.
    """

    is_awaited = True
    num_started = 0

    def __init__(self, work: Callable[[Sequence[Path]], int]):
        self._work = work

    def check(self, name):
        return

    def start(self, name, folders, groups, chunks):
        self.num_started += 1
        assert self._work(folders) == 0
