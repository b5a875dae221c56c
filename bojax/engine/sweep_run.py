"""A sweep in its results folder while it runs: the chunks left, the merge at the end, and the manifest."""

import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bojax.config.errors import printable
from bojax.config.saved_sweep import saved
from bojax.engine.chunks import Chunk
from bojax.engine.groups import StaticGroup
from bojax.engine.learners import merge_learners
from bojax.engine.manifest import describe_chunk, describe_groups, describe_sweep, outline_of
from bojax.engine.plan import Plan, plain
from bojax.engine.progress import GroupProgress
from bojax.engine.signals import StopRequest
from bojax.engine.storage import FolderStorage
from bojax.engine.targets import Target
from bojax.errors import FAILURE
from bojax.results.attempts import AttemptRegistry
from bojax.results.chunk_folder import ChunkFolder, ChunkState
from bojax.results.folder import RunFolder
from bojax.results.merge import RUNS, ChunkInfo, Merged, PointInfo, committed_files, merge
from bojax.results.store import MANIFEST, write_json

WARNINGS = {
    "nans": "NaN",
    "ignored_samples": "samples left out",
    "collapses": "an observation that no particle of the belief explained",
    "outside_actions": "an action outside of the space of actions",
    "sampled_gradient": "no sample, or only where the field is flat (are paths longer than the domain?)",
}
"""What is wrong with runs that have a notable value in a column."""


class SweepRun:
    """A sweep in its results folder, from its first file to its last."""

    attempts: AttemptRegistry  # the attempts at the chunks, once the folder is open

    def __init__(self, plan: Plan, target: Target, command: Sequence[str]):
        """Create an object, without writing anything; the command line is for the manifest."""
        self.plan, self.folder, self._target = plan, RunFolder(target.path), target
        self._command = shlex.join(command)
        self.merged: Merged | None = None  # what merging has found
        self._outlines = [outline_of(module) for module in plan.modules]
        self._files: Mapping[int, ChunkFolder] = {}
        self.planned = time.monotonic()  # when the object was created
        self._times: dict[str, float] = {}
        self._progress: dict[int, GroupProgress] = {}

    @property
    def path(self) -> Path:
        """The results folder."""
        return self.folder.path

    @property
    def left(self) -> list[Chunk]:
        """The chunks that are neither done nor failed, as of the last look at the folder."""
        return [chunk for chunk in self.plan.chunks if not self.attempts.has_ended(chunk.name)]

    @property
    def has_failed(self) -> bool:
        """Whether the sweep is merged without some of its chunks."""
        return self.merged is not None and bool(self.merged.errors)

    def open(self, *, retry: bool = True) -> None:
        """Create the results folder, or reopen it and verify what earlier processes have committed.

        Args:
            retry: Whether chunks that have failed are tried again.

        Raises:
            ResultsError: The folder belongs to another sweep, or a committed file is missing or has changed.
        """
        if self._target.is_resumed:
            self.folder.resume(self.plan.content)
        else:
            self.folder.create(self.plan.content, may_rename=self._target.may_rename)
        self.folder.describe(self.plan.device)
        self.attempts = AttemptRegistry(self.folder.work, self.path)
        self._files = committed_files(self.attempts, {chunk.index: chunk.name for chunk in self.plan.chunks})
        for chunk in self.plan.chunks:
            if chunk.name in self.attempts.done and not self._state(chunk).is_done:
                self.attempts.forget(chunk.name, "done")
            if chunk.name in self.attempts.failed and retry:
                self.attempts.forget(chunk.name, "failed")
        self.write_manifest("running")

    def launch(self) -> FolderStorage:
        """Begin a launch that makes this process the owner of all chunks that are left."""
        left = [chunk.index for chunk in self.left]
        launch = self.folder.launch(plain(saved(self.plan.sweep)), left)
        return FolderStorage(self.plan, self.folder, launch, self.attempts)

    def note_seconds(self, stage: str, seconds: float) -> None:
        """Note the wall time of a stage of the command, for the manifest."""
        self._times[stage] = round(seconds, 1)

    def note_progress(self, group: StaticGroup, progress: GroupProgress) -> None:
        """Note when a group is compiled and run, also later than now."""
        self._progress[group.index] = progress

    def finalise(self, say: Callable[[str], Any], finish: Callable[[Path], Any]) -> None:
        """Merge the sweep, say how it ended, and finish it unless a chunk has failed.

        Args:
            say: Prints a line.
            finish: Called with the results folder of a finished sweep.
        """
        merged = self._merge()
        for column, number in {"nans": len(merged.nans), **merged.notable}.items():
            if number:
                runs, what = "run" if number == 1 else "runs", WARNINGS[column]
                say(f"warning: {number} {runs} with {what}: see column {column} of runs.parquet")
        print(self.path)
        if merged.errors:
            reasons = dict.fromkeys(merged.errors.values())
            failed = f"{len(merged.errors)} of {len(self.plan.chunks)} chunks failed"
            advice = "run again with --resume to retry them, or without it if you change the code"
            say(printable(f"error: {failed}: {'; '.join(reasons)}: {advice}"))
        else:
            finish(self.path)

    def _merge(self) -> Merged:
        """Write the tables and the manifest, and close the folder."""
        start, sweep = time.monotonic(), self.plan.sweep
        names = [RUNS, *(name for module in self.plan.modules for name in module.tables)]
        points = [PointInfo(p.index, p.label, p.variant, p.swept) for p in sweep.points]
        chunks = [ChunkInfo(c.name, c.index, c.group, c.point) for c in self.plan.chunks]
        merged = merge(self.path, chunks, names, points, sweep.seed)
        done = [files for files in merged.files.values() if files.state.is_done]
        merge_learners(self.path, done, [point["config"] for point in self.plan.content["points"]])
        self.merged, self._files = merged, merged.files
        self.note_seconds("merging", time.monotonic() - start)
        self.write_manifest("failed" if merged.errors else "finished")
        self.folder.close(finished=not merged.errors)
        return merged

    def write_manifest(self, status: str) -> None:
        """Write `manifest.json`."""
        plan, merged = self.plan, self.merged
        states = [(chunk, self._state(chunk)) for chunk in plan.chunks]
        errors = merged.errors if merged else {}
        nans: dict[str, int] = {}
        for (point, _), count in sorted(merged.nans.items()) if merged else ():
            nans[str(point)] = nans.get(str(point), 0) + count
        compiled = self.folder.compile_seconds()
        facts = [self._facts(group, compiled.get(str(group.index), 0.0)) for group in plan.groups]
        manifest = {
            **describe_sweep(plan.sweep, plan.content, self._outlines, self._command, status),
            "device": plan.device,
            "times": self._times,
            "groups": describe_groups(facts, states),
            "chunks": [describe_chunk(*state, errors.get(state[0].index)) for state in states],
            "programs": self.folder.programs(),
            "nans": nans,
            "sha256": merged.sha256 if merged else {},
        }
        write_json(self.path / MANIFEST, manifest)

    def _state(self, chunk: Chunk) -> ChunkState:
        """The progress of a chunk, as of the last time that its files were read."""
        return self._files[chunk.index].state if chunk.index in self._files else ChunkState()

    def _facts(self, group: StaticGroup, compile_seconds: float) -> dict[str, Any]:
        """What is known of a group besides its advances."""
        return {
            "name": self.plan.name(group),
            "points": list(group.points),
            "lanes_per_device": self.plan.layouts[group.index].lanes,
            "compile_seconds": compile_seconds,
            "times": self._times_of(group),
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


@dataclass(frozen=True)
class Invocation:
    """What all sweeps of a command have in common."""

    command: Sequence[str]  # the command line, for the manifests and for the hint on how to resume
    finish: Callable[[Path], Any]  # called with the results folder of each finished sweep
    stop: StopRequest

    def resuming(self, paths: Sequence[Path]) -> str:
        """The command that resumes the sweeps in results folders."""
        given = list(self.command)
        if len(paths) == 1 and not any(word == "--out" or word.startswith("--out=") for word in given):
            given += ["--out", str(paths[0])]
        if "--resume" not in given:
            given.append("--resume")
        return shlex.join(given)

    def exit_code(self, runs: Sequence[SweepRun]) -> int:
        """The exit code. If the command was interrupted, note this and print the command that resumes it."""
        if not self.stop:
            return FAILURE if any(run.has_failed for run in runs) else 0
        for run in runs:
            if run.merged is None:
                run.write_manifest("interrupted")
        print(f"interrupted; to resume:\n  {self.resuming([run.path for run in runs])}", file=sys.stderr)
        return self.stop.exit_code
