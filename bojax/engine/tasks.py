"""The tasks of a process in a sweep: its static groups, each with the chunks that are not done."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from bojax.engine.chunks import Chunk
from bojax.engine.devices import Device, workers_of
from bojax.engine.execute import GroupTask
from bojax.engine.progress import SweepProgress
from bojax.engine.runner import Limits
from bojax.engine.share import FolderShare
from bojax.results.leases import Standing


def tasks_of(
    share: FolderShare, stop: Callable[[], bool], *, name_sweep: bool = False, start: float = 0.0
) -> list[GroupTask]:
    """The groups of a sweep that have chunks to run.

    Args:
        share: The chunks.
        stop: Whether a stop is requested.
        name_sweep: Whether messages name the sweep.
        start: Where the process starts, as a fraction of the chunks from 0 to 1; the chunks before it come
            last. Workers that start apart seldom want the same chunk, and each compiles few groups.
    """
    plan, engine = share.plan, share.plan.sweep.engine
    standings = {chunk: share.standing(chunk) for chunk in plan.chunks}
    left = [chunk for chunk, standing in standings.items() if standing in (Standing.FREE, Standing.HELD)]
    first = int(start * len(left))
    by_group: dict[int, deque[Chunk]] = {}
    for chunk in left[first:] + left[:first]:
        by_group.setdefault(chunk.group, deque()).append(chunk)
    tasks = []
    for index, chunks in by_group.items():
        group = plan.groups[index]
        tasks.append(
            GroupTask(
                group=group,
                experiment=plan.experiment(group),
                name=f"{plan.sweep.name}: {plan.name(group)}" if name_sweep else plan.name(group),
                seed=plan.sweep.seed,
                layout=chunks[0].layout,
                platform=plan.device["platform"],
                chunks=deque(chunk for chunk in chunks if standings[chunk] is Standing.FREE),
                elsewhere=[chunk for chunk in chunks if standings[chunk] is Standing.HELD],
                limits=Limits(engine.segment_seconds, engine.checkpoint_seconds, stop),
                share=share,
                recorded_runs=plan.sweep.record.runs,
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


def progress_of(shares: Sequence[FolderShare], tasks: Sequence[GroupTask]) -> SweepProgress:
    """The progress of sweeps, with the runs that are done."""
    num_runs = sum(chunk.num_runs for share in shares for chunk in share.plan.chunks)
    waiting = sum(chunk.num_runs for task in tasks for chunk in (*task.chunks, *task.elsewhere))
    title = f"{len(shares)} sweeps" if len(shares) > 1 else shares[0].plan.sweep.name
    progress = SweepProgress(title, num_runs)
    progress.add([task.progress for task in tasks], runs_done=num_runs - waiting)
    return progress


def workers_for(
    tasks: Iterable[GroupTask], devices: Iterable[Device], cores: int | None = None
) -> list[Device]:
    """The device of each worker, on those platforms that groups are planned for."""
    platforms = {task.platform for task in tasks}
    return workers_of([device for device in devices if device.platform in platforms], cores)
