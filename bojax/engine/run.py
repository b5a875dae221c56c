"""Run a sweep: group its points, divide the groups into chunks, run the chunks, and merge their parts."""

import math
import shlex
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bojax.config.errors import ConfigError, printable
from bojax.config.files import display
from bojax.config.limits import CHUNKS
from bojax.engine.batch import Compiled
from bojax.engine.build import build
from bojax.engine.chunks import Chunk, cut
from bojax.engine.devices import LANES_ON_ACCELERATOR, choose_lanes, find_devices, make_mesh, prepare
from bojax.engine.errors import FAILURE, EngineError, out_of_memory
from bojax.engine.groups import StaticGroup, static_groups
from bojax.engine.hosted import Hosted
from bojax.engine.latency import measure_latency
from bojax.engine.manifest import describe_chunk, describe_group, describe_sweep, outline_of, timings
from bojax.engine.plan import make_plan
from bojax.engine.progress import SweepProgress
from bojax.engine.provenance import device_description
from bojax.engine.runner import ChunkRunner
from bojax.engine.signals import StopRequest
from bojax.experiments.base import Experiment
from bojax.results.folder import RunFolder, check_finished, choose_folder, drop_leftovers, is_unfinished
from bojax.results.merge import RUNS, PointInfo, merge
from bojax.results.parts import ChunkFolder
from bojax.results.store import MANIFEST, ResultsError, write_atomically, write_json, write_table
from bojax.text import error_line

if TYPE_CHECKING:
    from bojax.config.sweep import Point, Sweep

NaNs = dict[tuple[int, int], int]
"""Number of NaNs of each (point, run) that has any."""


def run_sweep(
    sweep: "Sweep",
    out: Path | None,
    resume: bool,
    command: list[str],
    finish: Callable[[Path], Any] | None = None,
) -> int:
    """Run or resume a sweep and write its results folder.

    Args:
        sweep: The sweep, in which parts given by import path have been resolved.
        out: The results folder; `results/<name>/<timestamp>` if None.
        resume: Continue an unfinished sweep, in `out` or in the newest unfinished folder of this name.
        command: The command line of the sweep, for the manifest and for the hint on how to resume.
        finish: Called with the results folder once the sweep is finished, for instance to write a report.

    Returns:
        The exit code: 0; 1 if something failed; 2 for an input error; 130 or 143 after a signal.
    """
    try:
        with StopRequest() as stop:
            path, is_resumed = choose_folder(sweep.name, out, resume=resume)
            prepare(sweep.engine.device)
            folder = RunFolder(path)
            run = SweepRun(sweep, folder, command, stop)
            if is_resumed and not is_unfinished(path):
                check_finished(path, run.plan)
                drop_leftovers(path)
                print(f"{path}: already finished")
                code = 0
            else:
                code = run.execute(is_resumed=is_resumed, may_rename=out is None)
    except (ConfigError, ResultsError, EngineError) as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return error.exit_code
    if code == 0 and finish is not None:
        finish(folder.path)
    return code


class SweepRun:
    """The execution of one sweep into one results folder.

    The constructor builds and checks every point; only `execute` writes files.

    Attributes:
        plan: The plan of the sweep, `bojax.engine.plan`.
        groups: The static groups.
        chunks: All chunks, in the order in which they run.
    """

    def __init__(self, sweep: "Sweep", folder: RunFolder, command: list[str], stop: StopRequest):
        self._sweep, self._folder, self._command, self._stop = sweep, folder, command, stop
        self._devices = find_devices(sweep.engine.device)
        self._device = device_description(self._devices)
        self._modules = [self._build(point) for point in sweep.points]
        self._outlines = [outline_of(module) for module in self._modules]
        self.groups = static_groups(self._modules)
        self._lanes = [self._choose_lanes(group) for group in self.groups]
        self.plan = make_plan(sweep, self._modules, self._device, self._lanes)
        self.chunks = self._cut()
        self._files: list[ChunkFolder] = []
        self._facts: list[dict[str, Any]] = []
        self._errors: dict[int, str] = {}

    def execute(self, *, is_resumed: bool, may_rename: bool) -> int:
        """Run the unfinished chunks of the sweep, write its results and return the exit code.

        Args:
            is_resumed: Whether the folder holds an unfinished sweep; otherwise the folder is created.
            may_rename: Whether a new folder whose name is taken gets a number appended to the name.
        """
        is_finished = False
        try:
            self._open(is_resumed, may_rename)
            self._write_manifest("running")
            with SweepProgress(self._sweep.name, sum(chunk.num_lanes for chunk in self.chunks)) as progress:
                for group in self.groups:
                    self._run_group(group, progress)
                self._measure_latency(progress)
            if self._stop:
                self._write_manifest("interrupted")
                print(f"interrupted; to resume:\n  {self._resume_command()}", file=sys.stderr)
                return self._stop.exit_code
            nans = self._merge()
            is_finished = not self._errors
            self._write_manifest("finished" if is_finished else "failed", nans)
        finally:
            self._folder.close(finished=is_finished)
        return self._conclude(nans)

    def _build(self, point: "Point") -> Experiment:
        """The module of a point; its errors name the file of the sweep."""
        try:
            return build(point.config, getattr(point.config, "dtype", "float64"))
        except ConfigError as error:
            number = f" (point {point.index})" if len(self._sweep.points) > 1 else ""
            raise ConfigError(f"{display(self._sweep.source)}: {error}{number}") from error

    def _choose_lanes(self, group: StaticGroup) -> int:
        num_lanes, given = len(group.points) * self._sweep.runs, self._sweep.engine.lanes_per_device
        limit = LANES_ON_ACCELERATOR
        if self._device["platform"] == "cpu":
            limit = self._modules[group.points[0]].lanes_on_cpu
        return choose_lanes(num_lanes, len(self._devices), limit, given)

    def _cut(self) -> list[Chunk]:
        configs = [point["config"] for point in self.plan["points"]]
        context = {key: self.plan[key] for key in ("seed", "record", "device", "versions", "code")}
        chunks: list[Chunk] = []
        sizes = [lanes * len(self._devices) for lanes in self._lanes]
        numbers = [
            math.ceil(len(group.points) * self._sweep.runs / size)
            for group, size in zip(self.groups, sizes, strict=True)
        ]
        CHUNKS.check(sum(numbers), "engine.lanes_per_device")
        for group, lanes, size in zip(self.groups, self._lanes, sizes, strict=True):
            context["lanes_per_device"] = lanes
            chunks += cut(group, range(self._sweep.runs), size, configs, context, first_index=len(chunks))
        return chunks

    def _open(self, is_resumed: bool, may_rename: bool) -> None:
        if is_resumed:
            self._folder.resume(self.plan)
        else:
            self._folder.create(self.plan, may_rename=may_rename)
        fresh = [
            {
                "lanes_per_device": lanes,
                "devices": len(self._devices),
                "compile_seconds": 0.0,
                "latency_seconds": {},
            }
            for lanes in self._lanes
        ]
        self._facts = self._folder.noted("groups", fresh)
        self._files = [self._folder.chunk(chunk.name) for chunk in self.chunks]
        for files in self._files:
            files.open()

    def _run_group(self, group: StaticGroup, progress: SweepProgress) -> None:
        todo: list[tuple[Chunk, ChunkFolder]] = []
        for chunk, files in zip(self.chunks, self._files, strict=True):
            if chunk.group == group.index and files.state.is_done:
                progress.skip(chunk.num_lanes)
            elif chunk.group == group.index:
                todo.append((chunk, files))
        if not todo or self._stop:
            return
        try:
            runner = self._compile(group, progress)
        except (Exception, SystemExit) as error:  # user's code may call sys.exit
            self._fail([chunk for chunk, _ in todo], error, progress)
            return
        for chunk, files in todo:
            if self._stop:
                return
            try:
                runner.run(chunk, files)
            except ResultsError:
                raise  # a full disk or an unreadable checkpoint: the user must act first
            except (Exception, SystemExit) as error:
                self._fail([chunk], error, progress)

    def _compile(self, group: StaticGroup, progress: SweepProgress) -> ChunkRunner:
        engine, recorded = self._sweep.engine, self._sweep.record.runs
        progress.compiling(self._name(group))
        mesh, lanes = make_mesh(self._devices), self._lanes[group.index]
        make = Hosted if self._modules[group.points[0]].is_hosted else Compiled
        program = make(group, mesh, lanes, self._sweep.seed, snapshots=recorded > 0)
        progress.compiled(self._name(group), program.compile_seconds)
        self._facts[group.index]["compile_seconds"] += program.compile_seconds
        self._folder.note("groups", self._facts)
        return ChunkRunner(
            program=program,
            tables=self._modules[group.points[0]].tables,
            recorded_tables=self._modules[group.points[0]].recorded_tables,
            recorded_runs=recorded,
            saves_learners=self._sweep.record.learners,
            configs=[point["config"] for point in self.plan["points"]],
            segment_seconds=engine.segment_seconds,
            checkpoint_seconds=engine.checkpoint_seconds,
            progress=progress,
            stop=self._stop,
        )

    def _fail(self, chunks: list[Chunk], error: BaseException, progress: SweepProgress) -> None:
        """Mark chunks as failed; other chunks continue. A file keeps the traceback of an unexpected error."""
        group = self.groups[chunks[0].group]
        known = error if isinstance(error, EngineError) else out_of_memory(error, self._lanes[group.index])
        message = str(known or error_line(error))
        if known is None:
            stack = self._folder.work / f"error-{chunks[0].index:05d}.txt"
            text = "".join(traceback.format_exception(error)).encode(errors="backslashreplace")
            write_atomically(stack, lambda temporary: temporary.write_bytes(text))
            message += f" (traceback in {stack})"
        self._errors |= {chunk.index: message for chunk in chunks}
        progress.say(
            f"failed: {self._name(group)}, {sum(chunk.num_lanes for chunk in chunks)} runs: {message}"
        )

    def _measure_latency(self, progress: SweepProgress) -> None:
        """Time a single run of the first point of each variant."""
        if not self._sweep.engine.latency:
            return
        firsts = {(point.label, point.variant): point.index for point in reversed(self._sweep.points)}
        for group in self.groups:
            points = sorted(set(group.points) & set(firsts.values()))
            if not points or self._stop or self._modules[points[0]].is_hosted:
                continue
            progress.timing(self._name(group))
            try:
                latencies = measure_latency(group, points, self._sweep.seed, self._devices[0])
            except (Exception, SystemExit) as error:  # a failure here leaves the results complete
                progress.say(f"latency of {self._name(group)} not measured: {error_line(error)}")
                continue
            self._facts[group.index]["latency_seconds"] = {str(i): latencies[i] for i in points}

    def _merge(self) -> NaNs:
        done = [files for files in self._files if files.state.is_done]
        names = dict.fromkeys([RUNS, *(name for module in self._modules for name in module.tables)])
        points = [PointInfo(p.index, p.label, p.variant, p.swept) for p in self._sweep.points]
        nans = merge(self._folder.path, done, names, points, self._sweep.seed)
        write_table(self._folder.path / "timings.parquet", timings(self._states()))
        return nans

    def _states(self):
        return [(chunk, files.state) for chunk, files in zip(self.chunks, self._files, strict=True)]

    def _write_manifest(self, status: str, nans: NaNs | None = None) -> None:
        states = self._states()
        by_point: dict[str, int] = {}
        for (point, _), count in sorted((nans or {}).items()):
            by_point[str(point)] = by_point.get(str(point), 0) + count
        groups = zip(self.groups, self._facts, strict=True)
        manifest = {
            **describe_sweep(self._sweep, self.plan, self._outlines, shlex.join(self._command), status),
            "device": self._device,
            "groups": [describe_group(group, self._name(group), states, facts) for group, facts in groups],
            "chunks": [describe_chunk(*state, self._errors.get(state[0].index)) for state in states],
            "nans": by_point,
        }
        write_json(self._folder.path / MANIFEST, manifest)

    def _name(self, group: StaticGroup) -> str:
        names = list(dict.fromkeys(self._sweep.points[point].variant for point in group.points))
        return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"

    def _resume_command(self) -> str:
        given = list(self._command)
        if not any(word == "--out" or word.startswith("--out=") for word in given):
            given += ["--out", str(self._folder.path)]
        return shlex.join(given if "--resume" in given else [*given, "--resume"])

    def _conclude(self, nans: NaNs) -> int:
        if nans:
            print(f"warning: {len(nans)} runs contain NaN: see column nans of runs.parquet", file=sys.stderr)
        print(self._folder.path)
        if not self._errors:
            return 0
        reasons = dict.fromkeys(self._errors.values())
        message = f"{len(self._errors)} of {len(self.chunks)} chunks failed: {'; '.join(reasons)}"
        print(printable(f"error: {message}: run again with --resume to retry them"), file=sys.stderr)
        return FAILURE
