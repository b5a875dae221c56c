"""Chunks: the runs of a static group divided into queues, each for one device."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bojax.engine.groups import StaticGroup
from bojax.experiments.base import Experiment
from bojax.numerics.lanes import LANES_ON_GPU

QUEUE_ON_CPU, QUEUE_ON_ACCELERATOR = 64, 4 * LANES_ON_GPU
"""Maximum of runs in a queue.

In a queue longer than its lanes, the next runs take the lanes of those that have finished. On an accelerator
that pays only beyond `LANES_ON_GPU`: an advance has a fixed cost, so that runs which fit at once are
done soonest if all start at once (benchmarks/results/2026-11-23-lanes.md).
"""

QUEUES_ON_CPU, QUEUES_ON_ACCELERATOR, SHORTEST_ON_CPU = 4, 16, 8
"""A group is divided into this number of queues, so that several devices or cores share it, unless they would
be shorter than `SHORTEST_ON_CPU` on a CPU, or all fit into the lanes of fewer queues on an accelerator.

Queues of runs that last for different times balance eight accelerators only if each has several of them.
"""

REPACKINGS = 100
"""Number of repackings of a run that lasts for all its advances. A repacking waits for the device, so this
bounds the time lost to them: about 0.2 ms each."""

NARROWING = 3
"""Factor between two numbers of lanes of a queue.

A smaller factor keeps more of the lanes busy, but each number of lanes is a program to compile.
"""


@dataclass(frozen=True)
class Layout:
    """How the runs of a group are divided and advanced. The bits of the results depend on it.

    It depends on the kind of device, but not on the number of devices.
    """

    queue: int  # maximum number of runs in a chunk
    widths: tuple[int, ...]  # numbers of lanes, in descending order; a chunk starts with the first
    # Number of advances after which finished runs leave their lanes: runs of the queue take their places, or,
    # once it is empty, the others move to the next smaller number of lanes. 0 for never
    repack: int

    @property
    def lanes(self) -> int:
        """Number of lanes with which a chunk starts."""
        return self.widths[0]

    def wider(self, width: int) -> int | None:
        """The next larger number of lanes; None for the largest."""
        return min((each for each in self.widths if each > width), default=None)


def choose_layout(experiment: Experiment, num_runs: int, platform: str, given: int | None) -> Layout:
    """The layout of a group, given one of its experiments, and the number of runs of all its points.

    `given` is the number of lanes chosen by the user; None for the default.
    """
    is_cpu = platform == "cpu"
    limit = given or (experiment.lanes_on_cpu if is_cpu else experiment.lanes_on_gpu)
    longest = limit if experiment.is_hosted else QUEUE_ON_CPU if is_cpu else QUEUE_ON_ACCELERATOR
    useful = num_runs // SHORTEST_ON_CPU if is_cpu else math.ceil(num_runs / experiment.lanes_on_gpu)
    common = QUEUES_ON_CPU if is_cpu else QUEUES_ON_ACCELERATOR
    num_queues = max(math.ceil(num_runs / longest), min(common, useful))
    queue = math.ceil(num_runs / num_queues)
    if experiment.is_hosted:
        return Layout(queue, (queue,), 0)
    widths = [min(limit, queue)]
    if not is_cpu:  # runs of equal length leave no lane empty
        rounds = math.ceil(num_runs / limit)
        widths = [math.ceil(num_runs / rounds)]
        queue = widths[0] * math.ceil(rounds / num_queues)
    narrowest = experiment.narrowest
    if narrowest is not None and not is_cpu and experiment.max_advances > 1:
        while widths[-1] >= NARROWING * narrowest:
            widths.append(math.ceil(widths[-1] / NARROWING))
    return Layout(queue, tuple(widths), math.ceil(experiment.max_advances / REPACKINGS))


@dataclass(frozen=True, eq=False)
class Chunk:
    """A queue of runs of one group."""

    group: int  # its index
    index: int  # index of the chunk in the sweep
    positions: np.ndarray  # for each run, the position of its point among those of the group
    points: np.ndarray  # for each run, the index of its point in the sweep
    runs: np.ndarray  # for each run, its index among the runs of the point
    layout: Layout  # how the runs are advanced
    identity: str  # hash of everything that the rows of the chunk depend on

    @property
    def num_runs(self) -> int:
        """Number of runs."""
        return len(self.runs)

    @property
    def name(self) -> str:
        """Name of the chunk's working folder."""
        return f"chunk-{self.index:05d}-{self.identity[:12]}"

    @property
    def point(self) -> int:
        """The point of all runs; -1 if they belong to several points."""
        points = np.unique(self.points)
        return int(points[0]) if len(points) == 1 else -1


def cut(
    group: StaticGroup,
    runs: Sequence[int],
    layout: Layout,
    configs: Sequence[Mapping[str, Any]],
    context: Mapping[str, Any],
    first_index: int = 0,
) -> list[Chunk]:
    """Divide the given runs of all points of a group into chunks; the run index varies fastest.

    `configs` has the resolved config of each point of the sweep, and `context` everything else that the rows
    depend on, such as seed and code.
    """
    positions = np.repeat(np.arange(len(group.points)), len(runs))
    all_runs = np.tile(np.asarray(runs, dtype=np.int32), len(group.points))
    points = np.asarray(group.points, dtype=np.int32)[positions]
    chunks = []
    for start in range(0, len(all_runs), layout.queue):
        part = slice(start, start + layout.queue)
        queue = list(zip(points[part].tolist(), all_runs[part].tolist(), strict=True))
        described = {point: configs[point] for point in sorted({point for point, _ in queue})}
        content = {"configs": described, "queue": queue, "layout": asdict(layout), "context": dict(context)}
        chunks.append(
            Chunk(
                group=group.index,
                index=first_index + len(chunks),
                positions=positions[part],
                points=points[part],
                runs=all_runs[part],
                layout=layout,
                identity=digest(content),
            )
        )
    return chunks


def digest(content: Any) -> str:
    """A hash of plain values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
