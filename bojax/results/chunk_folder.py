"""The working folder of a chunk: pieces of its tables, and the state file that commits them."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from bojax.results.store import (
    ARRAYS,
    LEARNERS,
    ResultsError,
    array_file,
    explained,
    fingerprint,
    link,
    read_checked_json,
    remove,
    sync,
    write_arrays,
    write_checked_json,
    write_table,
)

_PIECE = re.compile(r"piece-\d{6,}-(.+)\.parquet")
_CHECKPOINT, _LEARNERS = "checkpoint-", f"{LEARNERS}-"
"""Prefixes of the folders that Orbax writes."""


@dataclass
class ChunkState:
    """The committed progress of a chunk."""

    pieces: int = 0  # number of committed pieces
    advances: int = 0  # number of advances at the checkpoint
    # For each lane at the checkpoint, the index of its run in the chunk; -1 for none
    lanes: list[int] = field(default_factory=list)
    # For each lane, the number of advances at which its run started
    started: list[int] = field(default_factory=list)
    next_run: int = 0  # index of the next run that waits for a lane
    # Folder of the checkpoint to resume from; None before the first and after the last
    checkpoint: str | None = None
    is_done: bool = False  # whether the pieces hold all rows of the chunk
    # `[lanes, active steps, seconds]` of each segment
    segments: list[list[float]] = field(default_factory=list)
    # Size and SHA-256 of every committed file, by path in the folder of the chunk
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def num_ended(self) -> int:
        """Number of runs that have ended."""
        return self.next_run - sum(1 for run in self.lanes if run >= 0)

    def finish(self) -> None:
        """Note that the chunk is done; what only a resumed chunk needs is dropped."""
        self.is_done, self.checkpoint, self.lanes, self.started = True, None, [], []

    def copy(self) -> "ChunkState":
        """A copy of the progress at this moment."""
        lists = {"lanes": [*self.lanes], "started": [*self.started], "segments": [*self.segments]}
        return replace(self, **lists)


class ChunkFolder:
    """Pieces of tables `piece-<number>-<table>.parquet`, snapshots, learners, checkpoints, and `state.json`.

    Checkpoints, and the learners of each commit, are folders that Orbax writes.

    The state file is replaced atomically, after the files that it lists have been written. Other files are
    ignored: the next attempt at the chunk inherits only listed files. A listed file is verified by its
    checksum before it is used.
    """

    def __init__(self, path: Path, results: Path, chunk: str | None = None):
        """Create an object for a folder that exists, without reading it.

        Merging moves snapshots to the results folder. The name of the chunk is by default that of the folder.
        """
        self.path = path
        self.state = ChunkState()  # as committed, with the changes since then
        self._chunk = chunk or path.name
        self._results = results
        self._new: list[str] = []

    def read(self) -> bool:
        """Read the committed state and verify its files, changing nothing; False if there is no state."""
        if not os.path.lexists(self._state_file):
            return False
        while True:
            self.state = self._read_state()
            try:
                for name in self.state.files:
                    self.committed(name)
                return True
            except ResultsError:
                if self._read_state() == self.state:  # otherwise another process has committed meanwhile
                    raise

    def inherit(self, other: "ChunkFolder") -> bool:
        """Take over what another folder of this chunk has committed, which keeps its own files.

        Returns:
            Whether it was all there; another process may be writing to that folder.
        """
        for name in other.state.files:
            source, target = other.path / name, self.path / name
            if not os.path.lexists(source) and os.path.lexists(self._results / name):
                continue  # moved there by a merge
            self._make_folders(name)
            try:
                link(source, target)
            except FileNotFoundError:
                return False
        self.state = replace(other.state, files=dict(other.state.files))
        self._write_state(self.state)
        return True

    def write_piece(self, tables: dict[str, pa.Table]) -> None:
        """Write a piece, to be committed by the next commit."""
        for table, rows in tables.items():
            if rows.num_rows:
                write_table(self.add(f"piece-{self.state.pieces:06d}-{table}.parquet"), rows)
        self.state.pieces += 1

    def write_snapshot(self, point: int, run: int, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Write named arrays of a run that has ended, to be committed by the next commit."""
        write_arrays(self.add(f"{ARRAYS}/{array_file(point, run, name)}"), arrays)

    def add(self, name: str) -> Path:
        """The path of a new file, to be committed by the next commit; its folder is made if necessary."""
        self._make_folders(name)
        self._new.append(name)
        return self.path / name

    def add_checkpoint(self) -> Path:
        """The folder of a checkpoint after the current number of advances, which replaces the one before."""
        self.state.checkpoint = f"{_CHECKPOINT}{self.state.advances:08d}"
        return self.add(self.state.checkpoint)

    def add_learners(self) -> Path:
        """The folder of the learners of runs that have finished since the last commit."""
        return self.add(f"{_LEARNERS}{self.state.advances:08d}")

    def stage(self) -> tuple[ChunkState, list[str]]:
        """The progress, and what has been added since the last commit: a commit that begins now covers it."""
        names, self._new = self._new, []
        return self.state.copy(), names

    def commit(self, staged: tuple[ChunkState, list[str]] | None = None) -> None:
        """Commit what is staged, by default everything; a checkpoint that is not the last one is dropped."""
        state, names = staged or self.stage()
        files = {
            name: found
            for name, found in self.state.files.items()
            if _top(name) == state.checkpoint or not name.startswith(_CHECKPOINT)
        }
        with explained(self.path):
            for path in (self.path / name for name in names):
                if path.is_dir():  # Orbax leaves it to the system when this is on the disk
                    sync(path, *path.rglob("*"))
            sync(*{folder for name in names for folder in self._folders(name)}, self.path)
        for path in [path for name in names for path in _files(self.path / name)]:
            found = fingerprint(path)
            if found is None:
                raise self._refusal(path, "missing")
            files[path.relative_to(self.path).as_posix()] = found
        self.state.files = state.files = files
        self._write_state(state)
        with explained(self.path):
            sync(self.path)  # before the previous checkpoint is deleted
            self._drop_trees()

    def committed(self, name: str) -> Path:
        """The path of a committed file, which merging may have moved to the results folder."""
        path = self.path / name
        if not os.path.lexists(path) and os.path.lexists(self._results / name):
            path = self._results / name
        found = fingerprint(path)
        if found != self.state.files[name]:
            raise self._refusal(path, "missing" if found is None else "changed since it was written")
        return path

    def pieces(self, name: str) -> Iterator[Path]:
        """The committed files of a table, in the order of writing."""
        for file in self.state.files:
            match = _PIECE.fullmatch(file)
            if match and match[1] == name:
                yield self.committed(file)

    def snapshots(self) -> list[str]:
        """Names of the committed snapshots."""
        return [name for name in self.state.files if name.startswith(f"{ARRAYS}/")]

    def checkpoint(self) -> Path:
        """The folder of the committed checkpoint."""
        assert self.state.checkpoint is not None
        return self._tree(self.state.checkpoint)

    def learners(self) -> list[Path]:
        """The committed folders of learners."""
        names = dict.fromkeys(map(_top, self.state.files))
        return [self._tree(name) for name in names if name.startswith(_LEARNERS)]

    def _tree(self, name: str) -> Path:
        for file in self.state.files:
            if _top(file) == name:
                self.committed(file)
        return self.path / name

    @property
    def _state_file(self) -> Path:
        return self.path / "state.json"

    def _write_state(self, state: ChunkState) -> None:
        write_checked_json(self._state_file, {"chunk": self._chunk, **vars(state)})

    def _read_state(self) -> ChunkState:
        try:
            content = read_checked_json(self._state_file)
            chunk, state = content.pop("chunk", None), ChunkState(**content)
        except (ResultsError, TypeError) as error:
            raise self._refusal(self._state_file, "damaged") from error
        if chunk != self._chunk:
            raise self._refusal(self._state_file, "copied from another chunk")
        return state

    def _drop_trees(self) -> None:
        """Delete the folders of Orbax that are not committed, also those that it has not completed."""
        kept = set(map(_top, self.state.files))
        for path in [*self.path.glob(f"{_CHECKPOINT}*"), *self.path.glob(f"{_LEARNERS}*")]:
            if path.name not in kept:
                remove(path)

    def _make_folders(self, name: str) -> None:
        """Make the folders of a file, except the chunk's own: a finished sweep must not get one again."""
        for folder in reversed(self._folders(name)):
            with explained(folder):
                folder.mkdir(exist_ok=True)

    def _folders(self, name: str) -> list[Path]:
        """The folders of a file, below the folder of the chunk."""
        return [self.path / folder for folder in Path(name).parents][:-1]

    def _refusal(self, path: Path, what: str) -> ResultsError:
        return ResultsError(
            f"{path}: {what}; delete the folder {self.path} and resume to compute this chunk again"
        )


def _top(name: str) -> str:
    """The file or folder in the folder of a chunk to which a file belongs."""
    return name.partition("/")[0]


def _files(path: Path) -> list[Path]:
    """A file, or all files in a folder."""
    return sorted(file for file in path.rglob("*") if not file.is_dir()) if path.is_dir() else [path]
