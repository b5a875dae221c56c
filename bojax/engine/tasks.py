"""The tasks of a process: the static groups of its sweeps, each with the chunks that it still has to run."""

import math
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from bojax.engine import program_cache
from bojax.engine.batch import Functions, Programs
from bojax.engine.chunks import Chunk, Layout
from bojax.engine.devices import Device, of_platform, workers_of
from bojax.engine.gpu_clients import clients_of
from bojax.engine.groups import StaticGroup
from bojax.engine.hosted import Hosted
from bojax.engine.plan import Plan
from bojax.engine.progress import GroupProgress, SweepProgress
from bojax.engine.runner import Limits
from bojax.engine.storage import FolderStorage, Storage
from bojax.experiments.base import Experiment


@dataclass(eq=False)
class GroupTask:
    """The unfinished chunks of a static group."""

    group: StaticGroup
    experiment: Experiment  # one of the group
    name: str  # for messages
    seed: int  # of the sweep
    layout: Layout  # how the runs are advanced
    platform: str  # of the devices that they are planned for
    chunks: deque[Chunk]  # those that no thread has taken yet
    limits: Limits  # when a chunk pauses
    storage: Storage  # where the rows of the chunks go
    recorded: int = 0  # largest number of recorded runs of a chunk
    running: int = field(default=0, init=False)  # number of chunks that threads have taken
    rank: int = field(default=0, init=False)  # its place in the order of compilation

    def __post_init__(self):
        self.functions = Functions(self.group)
        self.progress = GroupProgress(self.name)  # when it is compiled and run

    @property
    def most_steps(self) -> int:
        """Upper bound of the environment steps that are left, of all runs together."""
        num_runs = sum(chunk.num_runs for chunk in self.chunks)
        return num_runs * self.experiment.max_advances * self.experiment.steps_per_advance

    @property
    def kind(self) -> type[Programs]:
        """The class of its programs."""
        return Hosted if self.experiment.is_hosted else Programs

    def key(self, device: Device, width: int | None = None) -> "ProgramKey":
        """The programs for a number of lanes, by default the one with which a chunk starts."""
        return ProgramKey(self, device, self.layout.lanes if width is None else width)

    def keys(self, device: Device) -> list["ProgramKey"]:
        """The programs for all numbers of lanes."""
        return [self.key(device, width) for width in self.layout.widths]


class ProgramKey(NamedTuple):
    """The programs of a group for a number of lanes on a device."""

    task: GroupTask
    device: Device
    width: int

    @property
    def name(self) -> str | None:
        """Their name in the cache; None if they cannot be saved."""
        task, device, width = self
        return task.kind.key_of(task.group, device, width, task.recorded, task.layout.wider(width))

    @property
    def is_new(self) -> bool:
        """Whether they can be in the cache, but are not."""
        return self.name is not None and not program_cache.is_saved(self.name)


def tasks_of(
    plan: Plan, chunks: Iterable[Chunk], storage: Storage, *, name_sweep: bool = False
) -> list[GroupTask]:
    """The groups of a sweep that have some of these chunks to run, whose rows go to the storage."""
    engine = plan.sweep.engine
    by_group: dict[int, deque[Chunk]] = {}
    for chunk in chunks:
        by_group.setdefault(chunk.group, deque()).append(chunk)
    recorded = dict.fromkeys(by_group, 0)  # of all chunks, so that all processes have the same programs
    for chunk in plan.chunks:
        if chunk.group in recorded:
            found = int((chunk.runs < plan.sweep.record.runs).sum())
            recorded[chunk.group] = max(recorded[chunk.group], found)
    tasks = []
    for index, own in by_group.items():
        group = plan.groups[index]
        tasks.append(
            GroupTask(
                group=group,
                experiment=plan.experiment(group),
                name=f"{plan.sweep.name}: {plan.name(group)}" if name_sweep else plan.name(group),
                seed=plan.sweep.seed,
                layout=own[0].layout,
                platform=plan.device["platform"],
                chunks=own,
                limits=Limits(engine.segment_seconds, engine.checkpoint_seconds),
                storage=storage,
                recorded=recorded[index],
            )
        )
    return tasks


def longest_first(sweeps: Iterable[Sequence[GroupTask]]) -> list[GroupTask]:
    """The groups of several sweeps, the longest sweep first, and in it the longest group.

    The length is an upper bound of the number of environment steps. It underrates planning, whose steps take
    far longer than those of a tabular learner; but programs of planners also take long to compile, and the
    learners that come first keep the device busy meanwhile. With the short groups last, several devices
    finish at about the same time. The groups of a sweep stay together, so that its report is written while
    the groups of the next sweep run.
    """
    by_length = sorted(sweeps, key=lambda tasks: sum(task.most_steps for task in tasks), reverse=True)
    return [
        task for tasks in by_length for task in sorted(tasks, key=lambda task: task.most_steps, reverse=True)
    ]


def progress_of(owned: Mapping[FolderStorage, Sequence[Chunk]], tasks: Sequence[GroupTask]) -> SweepProgress:
    """The progress of sweeps, with the runs that are done of all chunks that this process owns."""
    num_runs = sum(chunk.num_runs for chunks in owned.values() for chunk in chunks)
    waiting = sum(chunk.num_runs for task in tasks for chunk in task.chunks)
    title = f"{len(owned)} sweeps" if len(owned) > 1 else next(iter(owned)).plan.sweep.name
    progress = SweepProgress(title, num_runs)
    progress.add([task.progress for task in tasks], runs_done=num_runs - waiting)
    return progress


def workers_for(
    tasks: Iterable[GroupTask], devices: Sequence[Device], cores: int | None = None
) -> list[Device]:
    """The device of each worker, on the platforms that groups are planned for.

    A GPU is several devices if it has several chunks to run.
    """
    num_chunks = Counter[str]()
    for task in tasks:
        # Each client would make its own environments for the steps on the host.
        num_chunks[task.platform] += 1 if task.experiment.is_hosted else len(task.chunks)
    used: list[Device] = []
    for platform, number in num_chunks.items():
        found = of_platform(devices, platform)
        for device in found:
            used += clients_of(device, math.ceil(number / len(found)))
    return workers_of(used, cores)
