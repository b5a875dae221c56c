"""Sinks: where the rows, snapshots, learners and checkpoints of a chunk go."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from jaxtyping import PyTree
from typing_extensions import override

from bojax.config.files import EXPERIMENT
from bojax.config.settings import Record
from bojax.config.yaml_file import dump
from bojax.experiments.base import Carry
from bojax.numerics import checkpoint
from bojax.results.parts import ChunkFolder, ChunkState
from bojax.results.store import LEARNERS, write_content

LEARNED = "learner.npz"
"""File of a saved learner's arrays, next to the config that evaluates the learner."""

EVALUATION_EPISODES = 20
"""Number of episodes of an evaluation; `episodes=` overrides it."""


class Sink(abc.ABC):
    """Receives the rows, snapshots, learners and checkpoints of a chunk.

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
        folder = f"{LEARNERS}/{point}-{run}"
        text = dump(evaluation(self._configs[point]))
        write_content(self._files.add(f"{folder}/{EXPERIMENT}"), text)
        checkpoint.save(self._files.add(f"{folder}/{LEARNED}"), learned)

    @override
    def save(self, carry: Carry) -> None:
        checkpoint.save(self._files.add_checkpoint(), carry)
        self._files.commit()

    @override
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        assert self.state.checkpoint is not None
        return checkpoint.restore(self._files.committed(self.state.checkpoint), structure)

    @override
    def finish(self) -> None:
        self.state.finish()
        self._files.commit()


class MemorySink(Sink):
    """Keeps everything in memory.

    Attributes:
        tables: The parts of each table.
        snapshots: The named arrays of each `(point, run, name, when)`.
        learned: The exported state of the learner of each `(point, run)`.
    """

    def __init__(self, *, recorded_runs: int = 0, saved_learners: int = 0):
        self.state = ChunkState()
        self.recorded_runs, self.saved_learners = recorded_runs, saved_learners
        self.tables: dict[str, list[pa.Table]] = {}
        self.snapshots: dict[tuple[int, int, str, str], dict[str, np.ndarray]] = {}
        self.learned: dict[tuple[int, int], PyTree] = {}
        self._checkpoint: Carry | None = None

    @override
    def write_part(self, tables: dict[str, pa.Table]) -> None:
        for name, rows in tables.items():
            self.tables.setdefault(name, []).append(rows)

    @override
    def write_snapshot(
        self, point: int, run: int, name: str, when: str, arrays: dict[str, np.ndarray]
    ) -> None:
        self.snapshots[point, run, name, when] = arrays

    @override
    def write_learner(self, point: int, run: int, learned: PyTree) -> None:
        self.learned[point, run] = learned

    @override
    def save(self, carry: Carry) -> None:
        self.state.checkpoint = f"after {self.state.advances} advances"
        self._checkpoint = _copy(carry)

    @override
    def load(self, structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
        return _copy(self._checkpoint)

    @override
    def finish(self) -> None:
        self.state.finish()
        self._checkpoint = None


def _copy(carry: Carry) -> Carry:
    """A copy, since an advance takes over the buffers of its carry."""
    return jax.tree.map(jnp.copy, carry)


def evaluation(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config that evaluates a learner saved by an experiment of the given config."""
    kept = {name: value for name, value in config.items() if name not in ("kind", "target_return", "tests")}
    changed = {"saved": LEARNED, "schedule": "exploit", "episodes": EVALUATION_EPISODES, "stop": "never"}
    return {"experiment": config["kind"], **kept, **changed, "map_episodes": []}
