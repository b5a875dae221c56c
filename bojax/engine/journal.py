"""The journal of a sweep: its results folder while it runs, what is done, and what failed."""

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from bojax.config.saved_sweep import saved
from bojax.engine.choices import programs_in
from bojax.engine.chunks import Chunk
from bojax.engine.groups import StaticGroup
from bojax.engine.latency import Latency
from bojax.engine.manifest import describe_chunk, describe_groups, describe_sweep, outline_of, timings
from bojax.engine.plan import Plan, plain
from bojax.engine.progress import GroupProgress
from bojax.engine.storage import FolderStorage, compile_seconds
from bojax.results.attempts import AttemptRegistry
from bojax.results.folder import RunFolder
from bojax.results.merge import RUNS, PointInfo, merge
from bojax.results.parts import ChunkFolder, ChunkState
from bojax.results.store import ARRAYS, MANIFEST, fingerprint, write_json, write_table

NaNs = dict[tuple[int, int], int]
"""Number of NaNs of each (point, run) that has any."""


class Journal:
    """The progress of one sweep in its results folder.

    Attributes:
        plan: The plan of the sweep.
        folder: The working files in the results folder.
        errors: The error of each failed chunk, once the sweep is merged.
        is_merged: Whether the tables are written.
        planned: Time at which the journal was created.
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
        self._attempts: AttemptRegistry | None = None
        self.errors: dict[int, str] = {}
        self.is_merged = False
        self.nans: NaNs = {}
        self._outlines = [outline_of(module) for module in plan.modules]
        self._files: dict[int, ChunkFolder] = {}
        self._latency: dict[int, dict[int, Latency]] = {}
        self.planned = time.monotonic()
        self._times: dict[str, float] = {}
        self._sha256: dict[str, str] = {}
        self._progress: dict[int, GroupProgress] = {}

    @property
    def path(self) -> Path:
        """The results folder."""
        return self.folder.path

    @property
    def attempts(self) -> AttemptRegistry:
        """The attempts at the chunks, once the folder is open."""
        assert self._attempts is not None
        return self._attempts

    @property
    def left(self) -> list[Chunk]:
        """The chunks that are neither done nor failed, as far as known."""
        return [chunk for chunk in self.plan.chunks if not self.attempts.has_ended(chunk.name)]

    def open(self, *, retry: bool = True) -> None:
        """Create the results folder, or reopen it.

        Args:
            retry: Whether chunks that have failed are tried again.

        Raises:
            ResultsError: The folder belongs to another sweep, or a committed file is missing or has changed.
        """
        if self._is_resumed:
            self.folder.resume(self.plan.content)
        else:
            self.folder.create(self.plan.content, may_rename=self._may_rename)
        self.folder.describe(self.plan.device)
        self._attempts = AttemptRegistry(self.folder.work, self.path)
        self._verify(retry=retry)
        self.write_manifest("running")

    def launch(self) -> FolderStorage:
        """Begin a launch in which this process owns all chunks that are left."""
        left = [chunk.index for chunk in self.left]
        launch = self.folder.launch(plain(saved(self.plan.sweep)), left)
        return FolderStorage(self.plan, self.folder, launch, self.attempts)

    def _verify(self, *, retry: bool) -> None:
        """Read the committed files of earlier processes, and forget endings that do not fit them."""
        attempts = self.attempts
        for chunk in self.plan.chunks:
            if not attempts.newest(chunk.name):
                continue
            files = attempts.committed(chunk.name)
            if files is not None:
                self._files[chunk.index] = files
            if chunk.name in attempts.done and not self.state(chunk).is_done:
                attempts.forget(chunk.name, "done")
            if chunk.name in attempts.failed and retry:
                attempts.forget(chunk.name, "failed")

    def state(self, chunk: Chunk) -> ChunkState:
        """The progress of a chunk, as of the last time that its files were read."""
        return self._files[chunk.index].state if chunk.index in self._files else ChunkState()

    def note_latency(self, group: StaticGroup, seconds: Mapping[int, Latency]) -> None:
        """Note the latency of a single run of points of a group."""
        self._latency[group.index] = dict(seconds)

    def note_seconds(self, stage: str, seconds: float) -> None:
        """Note the wall time of a stage of the command, for the manifest."""
        self._times[stage] = round(seconds, 1)

    def note_progress(self, group: StaticGroup, progress: GroupProgress) -> None:
        """Note when a group is compiled and run, also later than now."""
        self._progress[group.index] = progress

    def merge(self) -> None:
        """Write the tables from the chunks that are done, and close the folder."""
        start = time.monotonic()
        sweep = self.plan.sweep
        attempts = self.attempts
        attempts.look()
        self.errors = {
            chunk.index: attempts.reason(chunk.name)
            for chunk in self.plan.chunks
            if chunk.name in attempts.failed and chunk.name not in attempts.done
        }
        for chunk in self.plan.chunks:
            if attempts.newest(chunk.name) and not self.state(chunk).is_done:
                files = attempts.committed(chunk.name)
                if files is not None:
                    self._files[chunk.index] = files
        done = [self._files[chunk.index] for chunk in self.plan.chunks if self.state(chunk).is_done]
        names = dict.fromkeys([RUNS, *(name for module in self.plan.modules for name in module.tables)])
        points = [PointInfo(p.index, p.label, p.variant, p.swept) for p in sweep.points]
        self.nans = merge(self.path, done, names, points, sweep.seed)
        write_table(self.path / "timings.parquet", timings(self._states()))
        self._sha256 = self._checksums([*names, "timings"], done)
        self.note_seconds("merging", time.monotonic() - start)
        self.write_manifest("failed" if self.errors else "finished")
        self.close(finished=not self.errors)
        self.is_merged = True

    def _checksums(self, tables: Collection[str], chunks: Collection[ChunkFolder]) -> dict[str, str]:
        """SHA-256 of the merged tables and of the snapshots, by path in the results folder."""
        found = {f"{name}.parquet": fingerprint(self.path / f"{name}.parquet") for name in tables}
        for chunk in chunks:
            found |= {
                name: chunk.state.files[name] for name in chunk.saved() if name.startswith(f"{ARRAYS}/")
            }
        return {name: each["sha256"] for name, each in found.items() if each is not None}

    def close(self, *, finished: bool = False) -> None:
        """Release the folder; delete the working files of a finished sweep."""
        self.folder.close(finished=finished)

    def write_manifest(self, status: str) -> None:
        """Write `manifest.json`."""
        plan, states = self.plan, self._states()
        by_point: dict[str, int] = {}
        for (point, _), count in sorted(self.nans.items()):
            by_point[str(point)] = by_point.get(str(point), 0) + count
        compiled = compile_seconds(self.folder.work)
        manifest = {
            **describe_sweep(plan.sweep, plan.content, self._outlines, self._command, status),
            "device": plan.device,
            "times": self._times,
            "groups": describe_groups(
                [self._facts(group, compiled.get(str(group.index), 0.0)) for group in plan.groups], states
            ),
            "chunks": [describe_chunk(*state, self.errors.get(state[0].index)) for state in states],
            "programs": programs_in(self.folder.choices),
            "nans": by_point,
            "sha256": self._sha256,
        }
        write_json(self.path / MANIFEST, manifest)

    def _facts(self, group: StaticGroup, compile_seconds: float) -> dict[str, Any]:
        """What is known of a group besides its advances."""
        latency = self._latency.get(group.index, {})
        return {
            "name": self.plan.name(group),
            "points": list(group.points),
            "lanes_per_device": self.plan.layouts[group.index].lanes,
            "compile_seconds": compile_seconds,
            "times": self._times_of(group),
            "latency_seconds": {str(point): each.median for point, each in latency.items()},
            "latency_range": {str(point): [each.least, each.largest] for point, each in latency.items()},
        }

    def _times_of(self, group: StaticGroup) -> dict[str, float]:
        """Seconds from the end of planning to what this process has done of a group."""
        progress = self._progress.get(group.index)
        if progress is None:
            return {}
        times = {
            "compiling": progress.compiling,
            "compiled": progress.compiled,
            "begun": progress.begun,
            "ended": progress.ended,
        }
        return {name: round(at - self.planned, 1) for name, at in times.items() if at is not None}

    def _states(self) -> list[tuple[Chunk, ChunkState]]:
        return [(chunk, self.state(chunk)) for chunk in self.plan.chunks]
