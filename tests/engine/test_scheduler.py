"""The scheduler, driven step by step: which chunk runs next, and what is compiled ahead."""

from collections import deque
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from bojax.engine import scheduler
from bojax.engine.chunks import Chunk, Layout
from bojax.engine.scheduler import Scheduler
from bojax.engine.tasks import GroupTask, ProgramKey, longest_first


class Device(NamedTuple):
    platform: str
    number: int = 0


CPU, GPU, OTHER = Device("cpu"), Device("gpu"), Device("gpu", 1)


class Task(GroupTask):
    """A group with as many chunks; only what the scheduler uses is there."""

    def __init__(self, name: str, chunks: int, *widths: int, platform="gpu", is_hosted=False, rank=0):
        self.name, self.platform, self.experiment = name, platform, SimpleNamespace(is_hosted=is_hosted)
        self.layout, self.running, self.rank = Layout(8, widths, 1), 0, rank
        none = np.zeros(0, int)
        self.chunks = deque(Chunk(0, i, none, none, none, self.layout, name) for i in range(chunks))


class Programs:
    """What a compiler would say."""

    def __init__(self):
        self.requested: set[ProgramKey] = set()
        self.ready: set[ProgramKey] = set()

    def compile(self, *keys):
        self.requested |= {*keys}
        self.ready |= {*keys}


def make(tasks: list[Any], *devices: Device, saved=()) -> tuple[Scheduler, Programs]:
    programs = Programs()
    made = Scheduler(
        tasks,
        devices,
        is_requested=programs.requested.__contains__,
        is_ready=programs.ready.__contains__,
        is_saved=lambda key: key.task in saved,
    )
    return made, programs


def taken(plan: Scheduler, device: Device) -> tuple[str, int] | None:
    """The group and the number of the next chunk."""
    found = plan.take(device)
    return None if found is None else (found[0].name, found[1].index)


def named(keys) -> list[tuple[str, int, int]]:
    return [(key.task.name, key.device.number, key.width) for key in keys]


def test_the_longest_sweep_comes_first_and_in_it_the_longest_group(monkeypatch):
    monkeypatch.setattr(Task, "most_steps", property(lambda task: len(task.chunks)))
    short, brief, long = Task("short", 18, 4), Task("brief", 4, 4), Task("long", 16, 4)
    assert longest_first([[short], [brief, long]]) == [long, brief, short]


def test_groups_run_in_their_order_as_soon_as_they_are_compiled():
    a, b = tasks = [Task("a", 2, 4), Task("b", 1, 4)]
    plan, programs = make(tasks, GPU)
    assert named(plan.to_compile_ahead()) == [("a", 0, 4), ("b", 0, 4)]
    assert plan.take(GPU) is None and not plan.is_over(GPU)
    programs.compile(b.key(GPU))
    assert taken(plan, GPU) == ("b", 0)  # the first group is not waited for
    programs.compile(a.key(GPU))
    assert taken(plan, GPU) == ("a", 0) and taken(plan, GPU) == ("a", 1) and plan.take(GPU) is None
    assert plan.running == [a, b] and plan.is_over(GPU)
    assert plan.release(b) and not plan.release(a) and plan.release(a)


def test_one_chunk_of_a_hosted_group_runs_at_a_time():
    a, b = tasks = [Task("a", 2, 4, platform="cpu", is_hosted=True), Task("b", 1, 4, platform="cpu")]
    plan, programs = make(tasks, CPU, CPU)
    programs.compile(a.key(CPU), b.key(CPU))
    assert taken(plan, CPU) == ("a", 0) and taken(plan, CPU) == ("b", 0) and plan.take(CPU) is None
    plan.release(a)
    assert taken(plan, CPU) == ("a", 1)


def test_groups_of_a_cpu_and_of_gpus_do_not_wait_for_each_other():
    a, b, c = tasks = [Task("a", 1, 4), Task("b", 1, 4, platform="cpu"), Task("c", 1, 4, platform="cpu")]
    plan, programs = make(tasks, GPU, CPU)
    assert [task.rank for task in tasks] == [0, 0, 1]
    programs.compile(a.key(GPU), c.key(CPU))
    assert taken(plan, CPU) == ("c", 0) and plan.take(CPU) is None and taken(plan, GPU) == ("a", 0)
    assert plan.is_over(GPU) and not plan.is_over(CPU)


def test_programs_ahead_are_limited_and_spread_over_the_devices(monkeypatch):
    monkeypatch.setattr(scheduler, "AHEAD_ON_ACCELERATOR", 4)
    a, b, c, d = tasks = [Task(name, 3, 4, 2) for name in "abcd"]
    plan, programs = make(tasks, GPU, OTHER)
    first = [("a", 0, 4), ("a", 0, 2), ("b", 1, 4), ("b", 1, 2)]
    assert named(plan.to_compile_ahead()) == first
    a.chunks.clear()  # it has ended
    assert named(plan.to_compile_ahead()) == [*first[2:], ("c", 0, 4), ("c", 0, 2)]
    # Saved programs are loaded on as many devices as there are chunks.
    for chunks, devices in ((3, [0, 1]), (1, [0])):
        saved = Task("saved", chunks, 4)
        plan, _ = make([saved], GPU, OTHER, saved=[saved])
        assert named(plan.to_compile_ahead()) == [("saved", device, 4) for device in devices]
    assert c.chunks and d.chunks and not programs.requested


def test_a_second_device_loads_what_the_first_one_has_compiled():
    a, b = tasks = [Task("a", 2, 4, 2), Task("b", 2, 4, 2)]
    plan, programs = make(tasks, GPU, OTHER)
    assert plan.to_load(OTHER) is None
    programs.compile(a.key(GPU))
    assert plan.to_load(OTHER) == (a.key(OTHER), a.key(GPU)) and plan.to_load(GPU) is None
    programs.compile(b.key(GPU))
    programs.requested.add(a.key(OTHER))
    assert plan.to_load(OTHER) == (b.key(OTHER), b.key(GPU))
    programs.ready.add(a.key(OTHER))
    assert plan.to_load(OTHER) is None  # it has something to run
    assert plan.source(a.key(OTHER, 2)) is None
    programs.requested.add(a.key(GPU, 2))
    assert plan.source(a.key(OTHER, 2)) == a.key(GPU, 2)


def test_programs_of_groups_that_have_ended_are_dropped_and_on_a_gpu_the_oldest(monkeypatch):
    monkeypatch.setattr(scheduler, "AHEAD_ON_ACCELERATOR", 2)
    tasks = [Task("a", 0, 4), Task("b", 0, 4), Task("c", 0, 4, 2), Task("d", 0, 4, platform="cpu")]
    a, b, c, d = tasks
    plan, programs = make(tasks, GPU, CPU)
    programs.compile(a.key(GPU), b.key(GPU), c.key(GPU), d.key(CPU))
    assert plan.unneeded(a) == plan.unneeded(b) == []
    assert plan.unneeded(c) == [c.key(GPU, 2), a.key(GPU)]  # one that was never compiled, and the oldest
    assert plan.unneeded(d) == [d.key(CPU)]
