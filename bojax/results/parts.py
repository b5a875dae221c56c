"""The working folder of one chunk: part files, and the state file that commits them."""

import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bojax.results.store import (
    ARRAYS,
    LEARNERS,
    ResultsError,
    array_file,
    explained,
    read_json,
    read_table,
    write_arrays,
    write_json,
    write_table,
)


@dataclass
class ChunkState:
    """What of a chunk is safely on disk.

    Attributes:
        parts: Number of committed parts; later files belong to a run that was cut off.
        advances: Advances made up to the checkpoint.
        remaining: Lanes that are not done there.
        checkpoint: Name of the checkpoint to go on from; None before the first and after the last one.
        is_done: Whether all rows of the chunk are in its parts.
        segments: `[lanes, active steps, seconds]` of each segment.
    """

    parts: int = 0
    advances: int = 0
    remaining: int = 0
    checkpoint: str | None = None
    is_done: bool = False
    segments: list[list[float]] = field(default_factory=list)


class ChunkFolder:
    """Part files `part-<number>-<table>.parquet`, snapshots, checkpoints, and `state.json`.

    The state file is written after the parts and the checkpoint that it names, and replaced atomically:
    whatever it does not name never happened.
    """

    def __init__(self, path: Path):
        self.path = path
        self.state = ChunkState()

    def open(self) -> None:
        """Create the folder, or take up a committed state and delete everything after it."""
        with explained(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            (self.path / ARRAYS).mkdir(exist_ok=True)
        if self._state_file.exists():
            try:
                self.state = ChunkState(**read_json(self._state_file))
            except (ResultsError, TypeError) as error:
                raise self._unreadable(self._state_file, "state file") from error
        for path in self.path.glob("part-*.parquet"):
            if self._number(path) >= self.state.parts:
                path.unlink()
        self._drop_checkpoints()
        for path in self._parts():
            self._check(path)

    def write_part(self, tables: dict[str, pa.Table]) -> None:
        """Add a part; it counts from the next commit on."""
        for name, table in tables.items():
            if table.num_rows:
                write_table(self.path / f"part-{self.state.parts:06d}-{name}.parquet", table)
        self.state.parts += 1

    def write_snapshot(
        self, point: int, run: int, name: str, when: str, arrays: dict[str, np.ndarray]
    ) -> None:
        """Keep named arrays of one run."""
        write_arrays(self.path / ARRAYS / array_file(point, run, name, when), arrays)

    def learner_folder(self, point: int, run: int) -> Path:
        """A folder for what a run has learned."""
        folder = self.path / LEARNERS / f"{point}-{run}"
        with explained(folder):
            folder.mkdir(parents=True, exist_ok=True)
        return folder

    def learners(self) -> Iterator[Path]:
        """Folders of the saved learners."""
        return (self.path / LEARNERS).glob("*-*")

    def checkpoint_path(self) -> Path:
        """Where the checkpoint of the present number of advances goes."""
        return self.path / f"checkpoint-{self.state.advances:08d}"

    def commit(self) -> None:
        """Make the parts written so far, and the checkpoint that the state names, the chunk's truth."""
        write_json(self._state_file, asdict(self.state))
        self._drop_checkpoints()

    def tables(self, name: str) -> Iterator[pa.Table]:
        """The committed parts of a table, in the order of their writing."""
        for path in self._parts():
            if path.name.endswith(f"-{name}.parquet"):
                yield read_table(path)

    def snapshots(self) -> Iterator[Path]:
        """Files of the kept arrays."""
        return (self.path / ARRAYS).glob("*.npz")

    @property
    def _state_file(self) -> Path:
        return self.path / "state.json"

    def _parts(self) -> list[Path]:
        return sorted(p for p in self.path.glob("part-*.parquet") if self._number(p) < self.state.parts)

    def _number(self, path: Path) -> int:
        return int(path.name.split("-")[1])

    def _drop_checkpoints(self) -> None:
        for path in self.path.glob("checkpoint-*"):
            if path.name != self.state.checkpoint:
                shutil.rmtree(path, ignore_errors=True)

    def _check(self, path: Path) -> None:
        try:
            pq.read_metadata(path)
        except (OSError, pa.ArrowException) as error:
            raise self._unreadable(path, "parquet file") from error

    def _unreadable(self, path: Path, what: str) -> ResultsError:
        return ResultsError(
            f"{path}: not a readable {what}: delete the folder {self.path} and resume "
            "to compute this chunk again"
        )
