"""The rounds of a search in its folder: sweeps of proposed points, then the confirmation of the best ones."""

import contextlib
import io
import math
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bojax.config.errors import say
from bojax.config.points import Sweep
from bojax.config.yaml_file import dump
from bojax.engine.program_cache import held
from bojax.engine.remote import Launcher
from bojax.engine.run import run_sweeps
from bojax.engine.targets import Request, say_new
from bojax.optimisation.search import Search, Values
from bojax.optimisation.space import slice_along
from bojax.report.ranking import Measure, config_of, ranking, scored
from bojax.report.source import Point, load
from bojax.results.folder import RunFolder, check_plan, is_unfinished, reserve_folder
from bojax.results.store import MANIFEST, TUNING, ResultsError, write_content, write_json
from bojax.tuning.page import (
    build_page,
    is_search,
    read_tuning,
    round_folder,
    round_name,
    written_if_not_worse,
)
from bojax.tuning.ranges import described, value_at
from bojax.tuning.task import Task

TOP = 3
"""Number of the best settings that are confirmed."""


def run_rounds(
    task: Task,
    out: Path | None,
    resume: bool,
    command: list[str],
    launcher: Launcher | None = None,
    devices: Sequence[int] | None = None,
) -> int:
    """Run or resume a search, write its report, and return the exit code.

    The state of the search follows from the seed and the tables of the finished rounds, so that a resumed
    search makes the proposals that an undisturbed one would have made. With `resume`, an unfinished search
    goes on, and a finished one in `out` is extended. Without a launcher, the chunks of a round run in this
    process.

    Raises:
        EngineError: The launcher is missing on this machine, or refuses its settings; nothing is written.
        ResultsError: The folder cannot be used.
    """
    if launcher is not None:
        launcher.check(f"{task.config.name}-tune")
    if resume and out is not None and is_search(out) and not is_unfinished(out):
        check_plan(out, read_tuning(out).plan.model_dump(mode="json"), task.content)
        folder, is_resumed = out, False
    else:
        folder, is_resumed = reserve_folder(f"{task.config.name}-tune", out, resume=resume)
        if resume and not is_resumed:
            say_new([folder])
    begun = sum(each.is_dir() for each in round_folder(folder, 0).parent.glob("*"))
    if begun > task.rounds:
        least = begun * task.batch * task.config.runs
        raise ResultsError(f"{folder}: has more rounds than --budget pays for; allowed: >= {least}")
    for key in task.recompiled:
        say(f"note: {key} fixes the shape of a program; each of its values is compiled anew")
    if not any(word == "--out" or word.startswith("--out=") for word in command):
        command = [*command, "--out", str(folder)]
    files, is_done = RunFolder(folder), False
    if is_resumed:
        files.resume(task.content)
    else:
        files.create(task.content)
    try:
        with held():  # rounds share compiled programs
            code = _Rounds(task, folder, command, launcher, devices).run()
        is_done = code == 0
    except KeyboardInterrupt:  # between two rounds; within one, the engine prints this
        again = command if "--resume" in command else [*command, "--resume"]
        print(f"to resume:\n  {shlex.join(again)}", file=sys.stderr)
        raise
    finally:
        files.close(finished=is_done)
    if is_done:
        print(build_page(folder))
    return code


class _Tried(NamedTuple):
    """A point whose runs are done: its round, its values and its score, the mean of the metric."""

    round: int
    values: Values
    score: float


class _Rounds:
    """A search that runs in its folder."""

    def __init__(
        self,
        task: Task,
        folder: Path,
        command: list[str],
        launcher: Launcher | None,
        devices: Sequence[int] | None,
    ):
        self._task, self._folder, self._command = task, folder, command
        self._launcher, self._devices = launcher, devices
        self._keys = [each.key for each in task.ranges]
        self._measure = Measure(task.column, task.is_least)
        self._search = Search(task.ranges, task.config.seed, task.batch, task.rounds * task.batch)
        self._tried: list[_Tried] = []
        self._longest: float | None = None

    def run(self) -> int:
        """Run the rounds that are left, and confirm the best points."""
        task = self._task
        for number in range(task.rounds):
            folder = round_folder(self._folder, number)
            if is_unfinished(folder) or not (folder / MANIFEST).is_file():
                if not (points := self._search.propose(task.batch)):
                    print("all values of the tuned settings have been tried")
                    break
                if code := self._run(task.sweep(points, round_name(number)), folder):
                    return code
            self._learn(number, folder)
        order = self._order()
        if not order:
            raise ResultsError(f"{self._folder}: {task.column} is not finite in some run of every point")
        confirmed = self._confirmed(order) if task.confirm else None
        if isinstance(confirmed, int):
            return confirmed
        self._write(order, confirmed)
        return 0

    def _run(self, sweep: Sweep, folder: Path) -> int:
        with contextlib.redirect_stdout(io.StringIO()):  # the paths of the rounds
            request, options = Request(sweep, folder), (folder.is_dir(), self._command)
            return run_sweeps([request], *options, launcher=self._launcher, indices=self._devices)

    def _learn(self, number: int, folder: Path) -> None:
        """Tell the search the scores of a finished round, and print the best point so far.

        Times count up to the end of the longest run of the first round: scores of all rounds are compared.
        """
        results, measure = load(folder), self._measure
        if number == 0:
            self._longest = measure.longest(results)
        tried = [
            _Tried(number, self._values(point), float(measure.values(results, point, self._longest).mean()))
            for point in results.points
        ]
        scores = [self._measure.sign * each.score for each in tried]
        self._search.tell([each.values for each in tried], scores)
        self._tried += tried
        if order := self._order():
            best = self._tried[order[0]].values
            mean, _ = self._expected([best])
            found = f"{self._measure.words} {mean[0]:.4g} expected at {described(self._task.ranges, best)}"
            print(f"round {number + 1} of {self._task.rounds}: {found}", flush=True)

    def _values(self, point: Point) -> Values:
        """The values of the tuned settings at a point of a round."""
        return tuple(point.swept[key] for key in self._keys)

    def _expected(self, points: Sequence[Values]) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean of the metric, and its standard deviation."""
        mean, std = self._search.predict(points)
        return self._measure.sign * mean, std

    def _order(self) -> list[int]:
        """The tried points with a finite score, the best posterior mean first."""
        mean, _ = self._search.predict([each.values for each in self._tried])
        order = np.argsort(-mean, kind="stable").tolist()
        return [index for index in order if math.isfinite(self._tried[index].score)]

    def _confirmed(self, order: Sequence[int]) -> str | int:
        """Run the best points and the config as written with another seed.

        Returns the name of the folder of these runs, or the exit code if they did not finish.
        """
        task, config = self._task, self._task.config
        points = [self._tried[index].values for index in order[:TOP]]
        written = self._written()
        if written is not None and written not in points:
            points.append(written)
        name = f"confirm-{len(self._tried)}-{task.confirm}"
        changes = {"runs": task.confirm, "seed": (config.seed + 1) % 2**32}
        sweep = task.sweep(points, name, **changes, record=config.record.model_dump(mode="json"))
        if code := self._run(sweep, self._folder / name):
            return code
        ranked = ranking(load(self._folder / name), self._measure)
        for each in ranked:
            if each.point.index == 0:
                print(f"the best setting of the search on fresh runs: {scored(self._measure, each)}")
        if better := written_if_not_worse(ranked, self._measure, written):
            print(f"the config as written, which is not worse there: {scored(self._measure, better)}")
        return name

    def _written(self) -> Values | None:
        """The tuned settings in the config as written; None if it does not have all of them."""
        written = [value_at(self._task.config.points[0].config, key) for key in self._keys]
        known = tuple(value for value in written if value is not None)
        return known if len(known) == len(written) else None

    def _write(self, order: Sequence[int], confirmed: str | None) -> None:
        """Write the config of the best point, and what the report reads."""
        task, best = self._task, self._tried[order[0]]
        results = load(round_folder(self._folder, best.round))
        point = next(point for point in results.points if self._values(point) == best.values)
        write_content(self._folder / "best.yaml", dump(config_of(results, point)))
        mean, std = self._expected([each.values for each in self._tried])
        write_json(
            self._folder / TUNING,
            {
                "plan": task.content,
                "name": task.config.name,
                "title": task.config.title,
                "points": [
                    {**each._asdict(), "mean": expected, "std": spread}
                    for each, expected, spread in zip(self._tried, mean.tolist(), std.tolist(), strict=True)
                ],
                "order": list(order),
                "noise_std": self._search.noise_std,
                "slices": [self._slice(index, best.values) for index in range(len(task.ranges))],
                "confirmed": confirmed,
                "written": self._written(),
            },
        )

    def _slice(self, index: int, best: Values) -> dict[str, Any]:
        """The posterior over one setting, the others as at the best point."""
        values = slice_along(self._task.ranges[index])
        mean, std = self._expected([(*best[:index], value, *best[index + 1 :]) for value in values])
        return {"values": values, "mean": mean.tolist(), "std": std.tolist()}
