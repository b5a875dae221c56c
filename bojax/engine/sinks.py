"""Sinks: where the rows, snapshots, learners and checkpoints of a chunk go."""

import abc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa
import yaml
from jaxtyping import PyTree
from typing_extensions import override

from bojax.config.files import EXPERIMENT
from bojax.config.settings import Record
from bojax.experiments.base import Carry
from bojax.numerics import checkpoint
from bojax.results.parts import ChunkFolder, ChunkState
from bojax.results.store import write_atomically

LEARNED = "learned"
"""Folder of a saved learner's arrays, next to the config that evaluates the learner."""

EVALUATION_EPISODES = 20
"""Number of episodes of an evaluation; `episodes=` overrides it."""


class Sink(abc.ABC):
    """Receives what a chunk produces.

    Attributes:
        state: The progress of the chunk, changed while it runs.
        recorded_runs: Number of recorded runs of each point, the first ones. Of these runs, snapshots and the
            rows of recorded tables are kept.
        saved_learners: Number of runs of each point, the first ones, whose learners are kept.
    """

    state: ChunkState
    recorded_runs: int
    saved_learners: int

    @abc.abstractmethod
    def write_part(self, tables: dict[str, pa.Table]) -> None:
        """Write the rows of a segment."""

    @abc.abstractmethod
    def write_snapshot(
        self, point: int, run: int, name: str, when: str, arrays: dict[str, np.ndarray]
    ) -> None:
        """Write named arrays of a run."""

    @abc.abstractmethod
    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        """Write the exported state of the learner of a run."""

    @abc.abstractmethod
    def save(self, carry: Carry) -> None:
        """Save a checkpoint."""

    @abc.abstractmethod
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        """The carry of the last checkpoint."""

    @abc.abstractmethod
    def finish(self) -> None:
        """Note that the chunk is done."""


class FolderSink(Sink):
    """Writes to the working folder of a chunk.

    Args:
        files: The working folder, opened.
        configs: Resolved config of each point.
        record: Which runs are recorded.
    """

    def __init__(self, files: ChunkFolder, configs: Sequence[Mapping[str, Any]], record: Record):
        self._files, self._configs = files, configs
        self.state = files.state
        self.recorded_runs = record.runs
        self.saved_learners = record.runs if record.learners else 0

    @override
    def write_part(self, tables: dict[str, pa.Table]) -> None:
        self._files.write_part(tables)

    @override
    def write_snapshot(
        self, point: int, run: int, name: str, when: str, arrays: dict[str, np.ndarray]
    ) -> None:
        self._files.write_snapshot(point, run, name, when, arrays)

    @override
    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        folder = self._files.learner_folder(point, run)
        text = yaml.safe_dump(evaluation(self._configs[point]), sort_keys=False)
        write_atomically(folder / EXPERIMENT, lambda temporary: temporary.write_text(text))
        checkpoint.save(folder / LEARNED, learned)

    @override
    def save(self, carry: Carry) -> None:
        path: Path = self._files.checkpoint_path()
        self.state.checkpoint = path.name
        checkpoint.save(path, carry)
        self._files.commit()

    @override
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        assert self.state.checkpoint is not None
        return checkpoint.restore(self._files.committed(self.state.checkpoint), structure)

    @override
    def finish(self) -> None:
        self.state.is_done, self.state.checkpoint = True, None
        self._files.commit()


class MemorySink(Sink):
    """Keeps rows and learners in memory, and saves no checkpoints.

    Attributes:
        tables: The parts of each table.
        learned: Exported state of the learner of each run.
    """

    def __init__(self, runs: int):
        self.state = ChunkState()
        self.recorded_runs, self.saved_learners = 0, runs
        self.tables: dict[str, list[pa.Table]] = {}
        self.learned: dict[int, PyTree] = {}

    @override
    def write_part(self, tables: dict[str, pa.Table]) -> None:
        for name, rows in tables.items():
            self.tables.setdefault(name, []).append(rows)

    @override
    def write_snapshot(
        self, point: int, run: int, name: str, when: str, arrays: dict[str, np.ndarray]
    ) -> None:
        raise NotImplementedError

    @override
    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        del point
        self.learned[run] = learned

    @override
    def save(self, carry: Carry) -> None:
        raise NotImplementedError

    @override
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        raise NotImplementedError

    @override
    def finish(self) -> None:
        self.state.is_done = True


def evaluation(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config that evaluates a learner saved by an experiment of the given config."""
    kept = {name: value for name, value in config.items() if name not in ("kind", "target_return", "tests")}
    changed = {"saved": LEARNED, "schedule": "exploit", "episodes": EVALUATION_EPISODES, "stop": "never"}
    return {"experiment": config["kind"], **kept, **changed, "map_episodes": []}
