"""Which chunk a device runs next, and which programs are compiled for it: decisions only, without threads.

The caller compiles, runs, and reports what has ended, and calls from one thread at a time.
"""

from collections import deque
from collections.abc import Callable, Sequence

from bojax.engine.chunks import Chunk
from bojax.engine.devices import Device, of_platform
from bojax.engine.tasks import GroupTask, ProgramKey

AHEAD_ON_CPU, AHEAD_ON_ACCELERATOR = 24, 192
"""Number of programs that are compiled ahead, and on an accelerator also kept afterwards; they take memory.

A sweep of many groups is held up by tracing, one group after the other, which must go on while groups run. On
a CPU both share the cores.
"""


class Scheduler:
    """The groups with chunks that are left, in the order of compiling and running them.

    Programs are requested, then ready once they are there, or an error in their place; some are saved in the
    cache.
    """

    def __init__(
        self,
        tasks: Sequence[GroupTask],
        devices: Sequence[Device],
        *,
        is_requested: Callable[[ProgramKey], bool],
        is_ready: Callable[[ProgramKey], bool],
        is_saved: Callable[[ProgramKey], bool],
    ):
        self._tasks, self._devices = list(tasks), list(dict.fromkeys(devices))
        self._is_requested, self._is_ready = is_requested, is_ready
        for platform in {device.platform for device in self._devices}:
            for rank, task in enumerate(of_platform(self._tasks, platform)):
                task.rank = rank  # the groups of a CPU and of GPUs are compiled side by side
        # Asked once: what this process compiles for one device, the others load when they need it.
        self._saved = {
            task
            for task in self._tasks
            if len(self._devices_of(task)) > 1 and all(map(is_saved, task.keys(self.first(task))))
        }
        self._unused: deque[ProgramKey] = deque()

    @property
    def running(self) -> list[GroupTask]:
        """The groups with running chunks."""
        return [task for task in self._tasks if task.running]

    def first(self, task: GroupTask) -> Device:
        """The device for which a group is compiled first."""
        return self._rotated(task)[0]

    def to_compile_ahead(self) -> list[ProgramKey]:
        """The programs to compile now, those of the first unfinished groups, which may be requested already.

        They are spread over the devices of each platform. Programs that an earlier sweep has saved are loaded
        on several devices at once: on as many as the group has chunks.
        """
        left = dict.fromkeys({device.platform for device in self._devices}, AHEAD_ON_ACCELERATOR)
        keys: list[ProgramKey] = []
        if "cpu" in left:
            left["cpu"] = AHEAD_ON_CPU
        for task in self._tasks:
            if left[task.platform] > 0 and (task.chunks or task.running):
                # A device that no chunk will run on would load them in vain.
                most = max(1, len(task.chunks)) if task in self._saved else 1
                found = [key for device in self._rotated(task)[:most] for key in task.keys(device)]
                left[task.platform] -= len(found)  # requested ones included: they take memory until dropped
                keys += found
        return keys

    def ready(self, device: Device) -> list[GroupTask]:
        """The groups with a chunk that can run on a device now."""
        return [task for task in self._free(device) if self._is_ready(task.key(device))]

    def take(self, device: Device) -> tuple[GroupTask, Chunk] | None:
        """The next chunk for a device, which then counts as running; None if none is ready."""
        task = next(iter(self.ready(device)), None)
        if task is None:
            return None
        task.running += 1
        return task, task.chunks.popleft()

    def release(self, task: GroupTask) -> bool:
        """A chunk that was taken has ended or paused; return whether its group has none left."""
        task.running -= 1
        return not task.chunks and not task.running

    def is_over(self, device: Device) -> bool:
        """Whether no chunk is left for a device."""
        return not any(task.chunks for task in of_platform(self._tasks, device.platform))

    def to_load(self, device: Device) -> tuple[ProgramKey, ProgramKey] | None:
        """Programs that a device lacks to run a chunk, and the same programs on a device that has them.

        None if a chunk is ready anyway, or if no other device has programs that this one could use.
        """
        if self.ready(device):
            return None
        unknown = [task for task in self._free(device) if not self._is_requested(task.key(device))]
        found = (
            (task.key(device), task.key(other))
            for task in unknown
            for other in self._devices_of(task)
            if self._is_ready(task.key(other))
        )
        return next(found, None)

    def source(self, key: ProgramKey) -> ProgramKey | None:
        """The same programs on another device for which they were requested: none are compiled twice."""
        others = (key._replace(device=device) for device in self._devices_of(key.task))
        return next(filter(self._is_requested, others), None)

    def unneeded(self, task: GroupTask) -> list[ProgramKey]:
        """The programs that are dropped once a group has ended.

        A GPU keeps many: to free one waits for whatever runs or is measured there, which may last until a
        measurement of XLA's tuning times out, after 0.1 s (openxla/xla#42347).
        """
        dropped: list[ProgramKey] = []
        for key in (key for device in self._devices_of(task) for key in task.keys(device)):
            is_kept = key.device.platform != "cpu" and self._is_ready(key)
            (self._unused if is_kept else dropped).append(key)
        while len(self._unused) > AHEAD_ON_ACCELERATOR:
            dropped.append(self._unused.popleft())
        return dropped

    def _free(self, device: Device) -> list[GroupTask]:
        """The groups with a chunk that may run on a device, once its programs are ready."""
        tasks = of_platform(self._tasks, device.platform)
        # Programs of a hosted group hold one vector of environments, which two chunks cannot both step.
        return [task for task in tasks if task.chunks and not (task.experiment.is_hosted and task.running)]

    def _devices_of(self, task: GroupTask) -> list[Device]:
        """The devices on which a group may run."""
        return of_platform(self._devices, task.platform)

    def _rotated(self, task: GroupTask) -> list[Device]:
        """The devices of a group, rotated so that successive groups begin on different ones."""
        devices = self._devices_of(task)
        first = task.rank % len(devices)
        return devices[first:] + devices[:first]
