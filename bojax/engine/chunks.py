"""Chunks: the lanes of a static group divided into batches of a fixed size."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bojax.engine.groups import StaticGroup


@dataclass(frozen=True)
class Chunk:
    """A batch of lanes of one group.

    Attributes:
        group: Index of the group.
        index: Index of the chunk in the sweep.
        positions: For each lane, the position of its point among those of the group.
        points: For each lane, the index of its point in the sweep.
        runs: For each lane, the index of its run.
        identity: Hash of everything that the rows of the chunk depend on.
    """

    group: int
    index: int
    positions: np.ndarray
    points: np.ndarray
    runs: np.ndarray
    identity: str

    @property
    def num_lanes(self) -> int:
        """Number of real lanes."""
        return len(self.runs)

    @property
    def name(self) -> str:
        """Name of the chunk's working folder."""
        return f"chunk-{self.index:05d}-{self.identity[:12]}"

    @property
    def point(self) -> int:
        """The point of all lanes; -1 if the lanes belong to several points."""
        points = np.unique(self.points)
        return int(points[0]) if len(points) == 1 else -1

    def padded(self, num_lanes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, runs and `is_real` of `num_lanes` lanes.

        The padding repeats real lanes, so that it takes no longer than they do.
        """
        lanes = np.arange(num_lanes) % self.num_lanes
        return self.positions[lanes], self.runs[lanes], np.arange(num_lanes) < self.num_lanes


def cut(
    group: StaticGroup,
    runs: Sequence[int],
    num_lanes: int,
    configs: Sequence[Mapping[str, Any]],
    context: Mapping[str, Any],
    first_index: int = 0,
) -> list[Chunk]:
    """Divide all runs of all points of a group into chunks; the run index varies fastest.

    Args:
        group: The group.
        runs: Indices of the runs of every point.
        num_lanes: Number of lanes of a chunk, on all devices together.
        configs: Resolved config of each point of the sweep.
        context: Everything else that the rows depend on, such as seed, lanes per device and code.
        first_index: Index of the first chunk in the sweep.
    """
    positions = np.repeat(np.arange(len(group.points)), len(runs))
    all_runs = np.tile(np.asarray(runs, dtype=np.int32), len(group.points))
    points = np.asarray(group.points, dtype=np.int32)[positions]
    chunks = []
    for start in range(0, len(all_runs), num_lanes):
        part = slice(start, start + num_lanes)
        lanes = list(zip(points[part].tolist(), all_runs[part].tolist(), strict=True))
        described = {point: configs[point] for point in sorted({point for point, _ in lanes})}
        chunks.append(
            Chunk(
                group=group.index,
                index=first_index + len(chunks),
                positions=positions[part],
                points=points[part],
                runs=all_runs[part],
                identity=digest({"configs": described, "lanes": lanes, "context": dict(context)}),
            )
        )
    return chunks


def digest(content: Any) -> str:
    """A hash of plain values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
