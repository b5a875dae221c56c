"""Run a sweep: points to static groups, groups to chunks, chunks to parts, parts to tables."""

import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from bojax.engine.batch import Compiled
from bojax.engine.chunks import Chunk, cut, digest
from bojax.engine.devices import choose_lanes, find_devices, make_mesh, prepare, setting
from bojax.engine.errors import FAILURE, EngineError, one_line, out_of_memory
from bojax.engine.groups import StaticGroup, static_groups
from bojax.engine.latency import measure_latency
from bojax.engine.plan import make_plan, plain
from bojax.engine.progress import SweepProgress
from bojax.engine.provenance import device_description, git_revision, versions
from bojax.engine.runner import ChunkRunner
from bojax.engine.signals import StopRequest
from bojax.experiments.base import Experiment
from bojax.results.folder import RunFolder, check_plan, choose_folder, is_unfinished, read_plan
from bojax.results.merge import RUNS, PointInfo, merge
from bojax.results.parts import ChunkFolder
from bojax.results.store import MANIFEST, ResultsError, write_json, write_table

if TYPE_CHECKING:
    from bojax.config.sweep import Sweep


def run_sweep(sweep: "Sweep", out: Path | None, resume: bool, command: list[str]) -> int:
    """Run or resume a sweep and write its results folder.

    Args:
        sweep: What to run.
        out: The results folder; `results/<name>/<timestamp>` if None.
        resume: Go on with an unfinished sweep, in `out` or in the newest unfinished folder of this name.
        command: The command line that asked for it, for the manifest and for the hint how to resume.

    Returns:
        The exit code: 0; 1 if something failed; 2 for an input error; 130 or 143 after a signal.
    """
    try:
        with StopRequest() as stop:
            path, is_resumed = choose_folder(sweep.name, out, resume=resume)
            prepare(sweep.engine.device)
            run = SweepRun(sweep, path, command, stop)
            if is_resumed and not is_unfinished(path):
                check_plan(path, read_plan(path), run.plan)
                print(f"{path}: already finished")
                return 0
            return run.execute(is_resumed=is_resumed)
    except (ResultsError, EngineError) as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


class SweepRun:
    """One sweep on its way into one results folder.

    Building it checks and builds every point; only `execute` writes.

    Attributes:
        plan: What the numbers depend on.
        groups: The static groups.
        chunks: All chunks, in the order in which they run.
    """

    def __init__(self, sweep: "Sweep", path: Path, command: list[str], stop: StopRequest):
        self._sweep, self._path, self._command, self._stop = sweep, path, command, stop
        self._devices = find_devices(sweep.engine.device)
        self._modules = build_modules(sweep)
        self.groups = static_groups(self._modules)
        self._device = device_description(self._devices)
        self._lanes = [
            choose_lanes(
                self._device["platform"],
                len(group.points) * sweep.runs,
                len(self._devices),
                sweep.engine.lanes_per_device,
            )
            for group in self.groups
        ]
        self.plan = make_plan(sweep, self._modules, self._device, self.groups, self._lanes)
        self.chunks = self._cut()
        self._folder = RunFolder(path)
        self._errors: dict[int, str] = {}
        self._facts: dict[str, dict[str, Any]] = {}

    def execute(self, *, is_resumed: bool) -> int:
        """Run what is left of the sweep, and write its results; returns the exit code."""
        if is_resumed:
            self._folder.resume(self.plan)
        else:
            self._folder.create(self.plan)
        self._facts = self._folder.noted("groups", {})
        folders = [self._folder.chunk(chunk.name) for chunk in self.chunks]
        finished = False
        try:
            for files in folders:
                files.open()
            self._write_manifest(folders, "running")
            num_lanes = sum(chunk.num_lanes for chunk in self.chunks)
            with SweepProgress(self._sweep.name, num_lanes) as progress:
                for group in self.groups:
                    self._run_group(group, folders, progress)
                if not self._stop:
                    self._measure_latency(progress)
            if self._stop:
                self._write_manifest(folders, "interrupted")
                print(f"interrupted; to go on:\n  {self._resume_command()}", file=sys.stderr)
                return self._stop.exit_code
            nans = self._merge(folders)
            finished = not self._errors
            self._write_manifest(folders, "finished" if finished else "failed", nans)
        finally:
            self._folder.close(finished=finished)
        return self._conclude(nans)

    def _cut(self) -> list[Chunk]:
        configs = [point["config"] for point in self.plan["points"]]
        chunks: list[Chunk] = []
        for group, lanes in zip(self.groups, self._lanes, strict=True):
            context = {key: self.plan[key] for key in ("seed", "record", "device", "versions", "code")}
            context["lanes_per_device"] = lanes
            size = lanes * len(self._devices)
            chunks += cut(group, range(self._sweep.runs), size, configs, context, first_index=len(chunks))
        return chunks

    def _run_group(self, group: StaticGroup, folders: list[ChunkFolder], progress: SweepProgress) -> None:
        todo = []
        for chunk, files in zip(self.chunks, folders, strict=True):
            if chunk.group == group.index and files.state.is_done:
                progress.skip(chunk.num_lanes)
            elif chunk.group == group.index:
                todo.append((chunk, files))
        if not todo or self._stop:
            return
        try:
            runner = self._compile(group, progress)
        except Exception as error:
            self._fail([chunk for chunk, _ in todo], error, progress)
            return
        for chunk, files in todo:
            if self._stop:
                return
            try:
                runner.run(chunk, files)
            except ResultsError:
                raise  # a full disk, an unreadable checkpoint: the user has to act first
            except Exception as error:
                self._fail([chunk], error, progress)

    def _compile(self, group: StaticGroup, progress: SweepProgress) -> ChunkRunner:
        sweep, name = self._sweep, self._group_name(group)
        progress.compiling(name)
        program = Compiled(
            group,
            make_mesh(self._devices),
            self._lanes[group.index],
            sweep.seed,
            snapshots=sweep.record.runs > 0,
        )
        progress.compiled(name, program.compile_seconds)
        facts = self._facts.setdefault(str(group.index), {"compile_seconds": 0.0})
        facts["compile_seconds"] += program.compile_seconds
        self._folder.note("groups", self._facts)
        return ChunkRunner(
            program=program,
            tables=self._modules[group.points[0]].tables,
            recorded_runs=sweep.record.runs,
            segment_seconds=sweep.engine.segment_seconds,
            checkpoint_seconds=sweep.engine.checkpoint_seconds,
            progress=progress,
            stop=self._stop,
        )

    def _fail(self, chunks: list[Chunk], error: Exception, progress: SweepProgress) -> None:
        """Note chunks as failed; the others go on."""
        lanes = self._lanes[chunks[0].group]
        known = error if isinstance(error, EngineError) else out_of_memory(error, lanes)
        message = str(known) if known else one_line(error)
        for chunk in chunks:
            self._errors[chunk.index] = message
        names = self._group_name(self.groups[chunks[0].group])
        progress.say(f"error: {names}, chunks {', '.join(str(chunk.index) for chunk in chunks)}: {message}")

    def _measure_latency(self, progress: SweepProgress) -> None:
        """Time a single run of the first point of each variant."""
        if not self._sweep.engine.latency:
            return
        firsts = {(point.label, point.variant): point.index for point in reversed(self._sweep.points)}
        for group in self.groups:
            points = [point for point in group.points if point in firsts.values()]
            if not points or self._stop:
                continue
            progress.compiling(f"{self._group_name(group)} at batch 1")
            try:
                latencies = measure_latency(group, points, self._sweep.seed, self._devices[0])
            except Exception as error:
                progress.say(f"latency of {self._group_name(group)} not measured: {one_line(error)}")
                continue
            facts = self._facts.setdefault(str(group.index), {"compile_seconds": 0.0})
            facts["latency_seconds"] = {str(point): seconds for point, seconds in latencies.items()}

    def _merge(self, folders: list[ChunkFolder]) -> dict[tuple[int, int], int]:
        done = [files for files in folders if files.state.is_done]
        names = dict.fromkeys(name for module in self._modules for name in module.tables)
        points = [PointInfo(p.index, p.label, p.variant, p.swept) for p in self._sweep.points]
        nans = merge(self._path, done, [RUNS, *(set(names) - {RUNS})], points, self._sweep.seed)
        columns: dict[str, list] = {"group": [], "point": [], "chunk": [], "segment": []}
        columns |= {"lanes": [], "active_steps": [], "seconds": []}
        for chunk, files in zip(self.chunks, folders, strict=True):
            for number, (lanes, steps, seconds) in enumerate(files.state.segments):
                row = (chunk.group, chunk.point, chunk.index, number, int(lanes), int(steps), float(seconds))
                for column, value in zip(columns.values(), row, strict=True):
                    column.append(value)
        write_table(self._path / "timings.parquet", pa.table(columns))
        return nans

    def _write_manifest(self, folders: list[ChunkFolder], status: str, nans: dict | None = None) -> None:
        sweep = self._sweep
        by_point: dict[str, int] = {}
        for (point, _), count in (nans or {}).items():
            by_point[str(point)] = by_point.get(str(point), 0) + count
        manifest = {
            "name": sweep.name,
            "title": sweep.title,
            "status": status,
            "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "command": shlex.join(self._command),
            "runs": sweep.runs,
            "seed": sweep.seed,
            "config": self.plan["config"],
            "config_hash": digest({key: self.plan[key] for key in ("runs", "seed", "record", "points")}),
            "points": [{"index": i, **point} for i, point in enumerate(self.plan["points"])],
            "report": sweep.report,
            "claims": list(sweep.claims),
            "engine": sweep.engine,
            "versions": versions(),
            "git": git_revision(),
            "device": self._device,
            "precision": {
                "x64": bool(setting("jax_enable_x64")),
                "dtypes": [str(point["config"].get("dtype", "float64")) for point in self.plan["points"]],
                "matmul": setting("jax_default_matmul_precision") or "set by each operation",
            },
            "groups": [self._describe_group(group, folders) for group in self.groups],
            "chunks": [self._describe_chunk(*pair) for pair in zip(self.chunks, folders, strict=True)],
            "nans": by_point,
            "plan": self.plan,
        }
        write_json(self._path / MANIFEST, plain(manifest))

    def _describe_group(self, group: StaticGroup, folders: list[ChunkFolder]) -> dict[str, Any]:
        segments = [
            segment
            for chunk, files in zip(self.chunks, folders, strict=True)
            if chunk.group == group.index
            for segment in files.state.segments
        ]
        facts = self._facts.get(str(group.index), {})
        return {
            "group": group.index,
            "name": self._group_name(group),
            "points": list(group.points),
            "lanes_per_device": self._lanes[group.index],
            "devices": len(self._devices),
            "compile_seconds": facts.get("compile_seconds", 0.0),
            "run_seconds": sum(seconds for _, _, seconds in segments),
            "active_steps": sum(steps for _, steps, _ in segments),
            "latency_seconds": facts.get("latency_seconds", {}),
        }

    def _describe_chunk(self, chunk: Chunk, files: ChunkFolder) -> dict[str, Any]:
        status = "failed" if chunk.index in self._errors else "done" if files.state.is_done else "unfinished"
        return {
            "chunk": chunk.index,
            "group": chunk.group,
            "point": chunk.point,
            "runs": chunk.num_lanes,
            "identity": chunk.identity,
            "status": status,
            "error": self._errors.get(chunk.index),
        }

    def _group_name(self, group: StaticGroup) -> str:
        names = list(dict.fromkeys(self._sweep.points[point].variant for point in group.points))
        return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"

    def _resume_command(self) -> str:
        given = list(self._command)
        if not any(word == "--out" or word.startswith("--out=") for word in given):
            given += ["--out", str(self._path)]
        return shlex.join(given if "--resume" in given else [*given, "--resume"])

    def _conclude(self, nans: dict[tuple[int, int], int]) -> int:
        if nans:
            print(f"warning: {len(nans)} runs contain NaN: see column nans of runs.parquet", file=sys.stderr)
        print(self._path)
        if self._errors:
            failed = f"{len(self._errors)} of {len(self.chunks)} chunks failed"
            print(f"error: {failed}: see {self._path / MANIFEST}; --resume tries them again", file=sys.stderr)
            return FAILURE
        return 0


def build_modules(sweep: "Sweep") -> list[Experiment]:
    """The experiment of every point."""
    from bojax.engine.build import build

    return [build(point.config, getattr(point.config, "dtype", "float64")) for point in sweep.points]
