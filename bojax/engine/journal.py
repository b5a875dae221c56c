"""The journal of a sweep: its results folder while it runs, what is done, and what failed."""

import threading
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bojax.engine.chunks import Chunk
from bojax.engine.errors import EngineError, out_of_memory
from bojax.engine.groups import StaticGroup
from bojax.engine.latency import Latency
from bojax.engine.manifest import describe_chunk, describe_group, describe_sweep, outline_of, timings
from bojax.engine.plan import Plan
from bojax.engine.sinks import FolderSink, Sink
from bojax.results.folder import RunFolder
from bojax.results.merge import RUNS, PointInfo, merge
from bojax.results.parts import ChunkFolder, ChunkState
from bojax.results.store import MANIFEST, write_atomically, write_json, write_table
from bojax.text import error_line

NaNs = dict[tuple[int, int], int]
"""Number of NaNs of each (point, run) that has any."""


class Journal:
    """The progress of one sweep in its results folder.

    Attributes:
        plan: The plan of the sweep.
        folder: The working files in the results folder.
        errors: The error of each failed chunk.
        is_merged: Whether the tables are written.
        nans: Number of NaNs of each (point, run), once the sweep is merged.
    """

    def __init__(self, plan: Plan, path: Path, command: str, *, is_resumed: bool, may_rename: bool):
        """Create a journal, without writing anything.

        Args:
            plan: The plan of the sweep.
            path: The results folder.
            command: The command line, for the manifest.
            is_resumed: Whether the folder holds an unfinished sweep; otherwise it is created.
            may_rename: Whether a new folder whose name is taken gets a number appended to the name.
        """
        self.plan, self.folder, self._command = plan, RunFolder(path), command
        self._is_resumed, self._may_rename = is_resumed, may_rename
        self.errors: dict[int, str] = {}
        self.is_merged = False
        self._lock = threading.Lock()  # programs are compiled in several threads
        self.nans: NaNs = {}
        self._outlines = [outline_of(module) for module in plan.modules]
        self._files: list[ChunkFolder] = []
        self._facts: list[dict[str, Any]] = []

    @property
    def path(self) -> Path:
        """The results folder."""
        return self.folder.path

    def open(self) -> None:
        """Create the results folder, or reopen it."""
        if self._is_resumed:
            self.folder.resume(self.plan.content)
        else:
            self.folder.create(self.plan.content, may_rename=self._may_rename)
        fresh = [
            {
                "lanes_per_device": self.plan.layout(group).lanes,
                "compile_seconds": 0.0,
                "latency_seconds": {},
                "latency_range": {},
            }
            for group in self.plan.groups
        ]
        self._facts = self.folder.noted("groups", fresh)
        self._files = [self.folder.chunk(chunk.name) for chunk in self.plan.chunks]
        for files in self._files:
            files.open()
        self.write_manifest("running")

    def state(self, chunk: Chunk) -> ChunkState:
        """The progress of a chunk."""
        return self._files[chunk.index].state

    def sink(self, chunk: Chunk) -> Sink:
        """Where the rows of a chunk go."""
        configs = [point["config"] for point in self.plan.content["points"]]
        return FolderSink(self._files[chunk.index], configs, self.plan.sweep.record)

    def note_compiled(self, group: StaticGroup, seconds: float) -> None:
        """Note the seconds of a compilation."""
        with self._lock:
            self._facts[group.index]["compile_seconds"] += seconds
            self.folder.note("groups", self._facts)

    def note_latency(self, group: StaticGroup, seconds: Mapping[int, Latency]) -> None:
        """Note the latency of a single run of points of a group."""
        facts = self._facts[group.index]
        facts["latency_seconds"] = {str(point): each.median for point, each in seconds.items()}
        facts["latency_range"] = {str(point): [each.least, each.largest] for point, each in seconds.items()}

    def note_failure(self, chunks: Sequence[Chunk], error: BaseException) -> str:
        """Note that chunks of a group failed, and return the reason in one line.

        The traceback of an unexpected error is kept in a file.
        """
        known = error if isinstance(error, EngineError) else out_of_memory(error, chunks[0].layout.lanes)
        message = str(known or error_line(error))
        if known is None:
            stack = self.folder.work / f"error-{chunks[0].index:05d}.txt"
            text = "".join(traceback.format_exception(error)).encode(errors="backslashreplace")
            write_atomically(stack, lambda temporary: temporary.write_bytes(text))
            message += f" (traceback in {stack})"
        self.errors |= {chunk.index: message for chunk in chunks}
        return message

    def merge(self) -> None:
        """Write the tables from the chunks that are done, and close the folder."""
        sweep = self.plan.sweep
        done = [files for files in self._files if files.state.is_done]
        names = dict.fromkeys([RUNS, *(name for module in self.plan.modules for name in module.tables)])
        points = [PointInfo(p.index, p.label, p.variant, p.swept) for p in sweep.points]
        self.nans = merge(self.path, done, names, points, sweep.seed)
        write_table(self.path / "timings.parquet", timings(self._states()))
        self.write_manifest("failed" if self.errors else "finished")
        self.folder.close(finished=not self.errors)
        self.is_merged = True

    def write_manifest(self, status: str) -> None:
        """Write `manifest.json`."""
        plan, states = self.plan, self._states()
        by_point: dict[str, int] = {}
        for (point, _), count in sorted(self.nans.items()):
            by_point[str(point)] = by_point.get(str(point), 0) + count
        groups = zip(plan.groups, self._facts, strict=True)
        manifest = {
            **describe_sweep(plan.sweep, plan.content, self._outlines, self._command, status),
            "device": plan.device,
            "groups": [describe_group(group, plan.name(group), states, facts) for group, facts in groups],
            "chunks": [describe_chunk(*state, self.errors.get(state[0].index)) for state in states],
            "nans": by_point,
        }
        write_json(self.path / MANIFEST, manifest)

    def _states(self) -> list[tuple[Chunk, ChunkState]]:
        return [(chunk, self.state(chunk)) for chunk in self.plan.chunks]
