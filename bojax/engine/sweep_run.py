"""A sweep in its results folder while it runs: the chunks left, the merge at the end, and the manifest."""

import shlex
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bojax.config.changed import changed_from_published
from bojax.config.errors import ConfigError, printable
from bojax.config.saved_sweep import saved
from bojax.engine.chunks import Chunk, digest
from bojax.engine.devices import setting
from bojax.engine.groups import StaticGroup
from bojax.engine.learners import merge_learners
from bojax.engine.plan import Plan, plain
from bojax.engine.progress import GroupProgress
from bojax.engine.provenance import git_revision, versions
from bojax.engine.signals import StopRequest
from bojax.engine.storage import FolderStorage
from bojax.engine.targets import Target
from bojax.errors import FAILURE
from bojax.results.attempts import AttemptRegistry
from bojax.results.chunk_folder import ChunkFolder, ChunkState
from bojax.results.folder import RunFolder
from bojax.results.merge import RUNS, Merged, committed_files, merge
from bojax.results.store import MANIFEST, write_json
from bojax.text import error_line

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
        self.progress: dict[int, GroupProgress] = {}  # when each group, by its index, is compiled and run

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

        With `retry`, chunks that have failed are tried again.

        Raises:
            ResultsError: The folder belongs to another sweep, or a committed file is missing or has changed.
        """
        if self._target.is_resumed:
            self.folder.resume(self.plan.content)
        else:
            self.folder.create(self.plan.content, may_rename=self._target.may_rename)
        self.folder.describe(self.plan.device)
        self.attempts = AttemptRegistry(self.folder.work, self.path)
        self._files = committed_files(self.attempts, [chunk.name for chunk in self.plan.chunks])
        for chunk in self.plan.chunks:
            if chunk.name in self.attempts.done and not self._state(chunk).is_done:
                self.attempts.forget(chunk.name, "done")
            if chunk.name in self.attempts.failed and retry:
                self.attempts.forget(chunk.name, "failed")
        self.write_manifest("running")

    def launch(self) -> FolderStorage:
        """Begin a launch that makes this process the owner of all chunks that are left."""
        launch = self.folder.launch(plain(saved(self.plan.sweep)), [chunk.index for chunk in self.left])
        return FolderStorage(self.plan, self.folder, launch, self.attempts)

    def note_seconds(self, stage: str, seconds: float) -> None:
        """Note the wall time of a stage of the command, for the manifest."""
        self._times[stage] = round(seconds, 1)

    def finalise(self, say: Callable[[str], Any], finish: Callable[[Path], Any]) -> None:
        """Merge the sweep, say how it ended, and finish its results folder unless a chunk has failed."""
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
        start, points = time.monotonic(), self.plan.content["points"]
        names = [RUNS, *(name for module in self.plan.modules for name in module.tables)]
        chunks = {chunk.name: (chunk.group, chunk.point) for chunk in self.plan.chunks}
        merged = merge(self.path, chunks, names, points, self.plan.sweep.seed)
        done = [files for files in merged.files.values() if files.state.is_done]
        merge_learners(self.path, done, [point["config"] for point in points])
        self.merged, self._files = merged, merged.files
        self.note_seconds("merging", time.monotonic() - start)
        self.write_manifest("failed" if merged.errors else "finished")
        self.folder.close(finished=not merged.errors)
        return merged

    def write_manifest(self, status: str) -> None:
        """Write `manifest.json`: the sweep, the command that started it, and the software that ran it."""
        plan, sweep, merged = self.plan, self.plan.sweep, self.merged
        points = zip(plan.content["points"], self._outlines, strict=True)
        nans = Counter[str]()
        for (point, _), count in sorted(merged.nans.items()) if merged else ():
            nans[str(point)] += count
        manifest = {
            "name": sweep.name,
            "title": sweep.title,
            "status": status,
            "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "command": self._command,
            "runs": sweep.runs,
            "seed": sweep.seed,
            "config": plan.content["config"],
            "config_hash": digest({key: plan.content[key] for key in ("runs", "seed", "record", "points")}),
            "points": [{"index": index, **point, **outline} for index, (point, outline) in enumerate(points)],
            "report": plain(sweep.report),
            "claims": plain(sweep.claims),
            "changed": plain(changed_from_published(sweep)),
            "is_published": sweep.is_published,
            "engine": plain(sweep.engine),
            "versions": versions(),
            "git": git_revision(),
            "precision": {
                "x64": bool(setting("jax_enable_x64")),
                "dtypes": sorted({each["config"].get("dtype", "float64") for each in plan.content["points"]}),
                "matmul": setting("jax_default_matmul_precision") or "set by each operation",
            },
            "plan": plan.content,
            "device": plan.device,
            "times": self._times,
            "groups": self._described_groups(),
            "chunks": [self._described(chunk) for chunk in plan.chunks],
            "programs": self.folder.programs(),
            "nans": nans,
            "sha256": merged.sha256 if merged else {},
        }
        write_json(self.path / MANIFEST, manifest)

    def _state(self, chunk: Chunk) -> ChunkState:
        """The progress of a chunk, as of the last time that its files were read."""
        return self._files[chunk.index].state if chunk.index in self._files else ChunkState()

    def _described(self, chunk: Chunk) -> dict[str, Any]:
        """The status of a chunk, and its error if it failed."""
        error = self.merged.errors.get(chunk.index) if self.merged else None
        return {
            "chunk": chunk.index,
            "group": chunk.group,
            "point": chunk.point,
            "runs": chunk.num_runs,
            "identity": chunk.identity,
            "status": "failed" if error else "done" if self._state(chunk).is_done else "unfinished",
            "error": error,
        }

    def _described_groups(self) -> list[dict[str, Any]]:
        """Seconds and steps of the static groups: compilation and advances."""
        compiled = self.folder.compile_seconds()
        segments: dict[int, list[list[float]]] = defaultdict(list)
        for chunk in self.plan.chunks:
            segments[chunk.group] += self._state(chunk).segments
        return [
            {
                "group": group.index,
                "name": self.plan.name(group),
                "points": list(group.points),
                "lanes_per_device": self.plan.layouts[group.index].lanes,
                "compile_seconds": compiled.get(str(group.index), 0.0),
                "times": self._times_of(group),
                "run_seconds": sum((seconds for _, _, seconds in segments[group.index]), 0.0),
                "active_steps": sum(int(steps) for _, steps, _ in segments[group.index]),
            }
            for group in self.plan.groups
        ]

    def _times_of(self, group: StaticGroup) -> dict[str, float]:
        """Seconds from the end of planning to what this process has done of a group."""
        progress = self.progress.get(group.index)
        times = {name: getattr(progress, name, None) for name in ("compiling", "compiled", "begun", "ended")}
        return {name: round(at - self.planned, 1) for name, at in times.items() if at is not None}


def outline_of(module: Any) -> dict[str, Any]:
    """The outline of the problem's world, which figures draw: `{"outline": ...}`, or `{}` without one.

    Raises:
        ConfigError: The problem's `outline` fails, or returns something else than an outline.
    """
    try:
        outline_of_problem = getattr(getattr(module, "problem", None), "outline", None)
        outline = outline_of_problem() if outline_of_problem else None
        return {} if outline is None else {"outline": outline.as_numbers()}
    except Exception as error:  # the user's code
        raise ConfigError(f"{type(module.problem).__name__}.outline: {error_line(error)}") from error


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
