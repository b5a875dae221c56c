"""Programs of sweeps are compiled while the sweeps that follow are still planned."""

from collections import deque
from collections.abc import Sequence

from bojax.engine.compile_processes import CompileProcesses, Request, number_of_processes
from bojax.engine.compiler import compile_threads
from bojax.engine.devices import Device, of_platform
from bojax.engine.plan import Plan
from bojax.engine.storage import Storage
from bojax.engine.tasks import longest_first, tasks_of
from bojax.engine.xla_choices import offer_shipped


class Ahead:
    """Child processes that compile the groups planned so far, once these are enough.

    To plan all sweeps of the thesis takes half a minute on slow cores, and keeps one of them busy. The others
    have compiled the first groups by then.

    Args:
        devices: The devices of this process.
    """

    def __init__(self, devices: Sequence[Device]):
        self.processes = CompileProcesses(0)
        self._devices = devices
        self._new: deque[Request] = deque()
        self._offered: set[str | None] = set()

    def offer(self, plan: Plan) -> None:
        """Compile the groups of a sweep that is planned, as soon as a process is idle."""
        for task in longest_first([tasks_of(plan, plan.chunks, Storage())]):
            key = task.key(of_platform(self._devices, task.platform)[0])
            if key.is_new and key.name not in self._offered:
                self._offered.add(key.name)
                self._new.append(Request.of(key))
        if not self.processes and number_of_processes(len(self._new), self._devices):
            self.processes = CompileProcesses(number_of_processes(compile_threads(), self._devices))
            for device in self._devices:
                offer_shipped(device)
        while self._new and self.processes.begin(self._new[0]):
            self._new.popleft()

    def __enter__(self) -> "Ahead":
        return self

    def __exit__(self, *error: object) -> None:
        self.processes.close()
