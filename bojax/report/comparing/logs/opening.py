"""Finds out what a file or folder of another library is, and reads its runs."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bojax.report.comparing.curve_files import Rows, read_curves, text_of
from bojax.report.comparing.logs import arrays, text_tables
from bojax.report.comparing.logs.event_files import event_columns
from bojax.report.comparing.logs.log import Columns, Log
from bojax.results.store import ResultsError

_PATTERNS = (
    re.compile(r"(?P<label>.+)__(?P<run>\d+)__\d{9,}"),  # CleanRL: ENV__LABEL__SEED__TIME
    re.compile(r"(?:(?P<label>.*?)[-_ ./]+)?(?:seed|run|s)[-_ =]*(?P<run>\d+)", re.IGNORECASE),
    re.compile(r"(?P<label>.+)_(?P<run>\d{1,4})"),  # Stable-Baselines3: LABEL_1, LABEL_2
    re.compile(r"(?:(?P<label>.*)/)?(?P<run>\d{1,9})"),  # a number alone
)

FOLDER = "a folder with *monitor.csv, progress.csv, evaluations.npz or event files of TensorBoard"


@dataclass(frozen=True)
class Source:
    """What a file or folder of another library has: logs of runs, or curves and scores by label."""

    path: Path
    logs: Sequence[Log] = ()
    rows: Sequence[Rows] = ()


def opened(given: Path) -> Source:
    """Read a file or folder of another library; the curves of logs are read when they are asked for.

    In `NAME=PATH`, the name is the label of all runs of the path.
    """
    label, equals, rest = str(given).partition("=")
    if equals and label and rest and not given.exists():
        runs = _runs_of(Path(rest))
        if runs is None:
            raise ResultsError(f"{rest}: has labels of its own; allowed: {rest} without {label}=")
        return Source(given, logs=[Log(label, None, None, given, path, columns) for _, path, columns in runs])
    runs = _runs_of(given)
    if runs is not None:
        return Source(given, logs=[_log(given, *run) for run in runs])
    if given.suffix in (".npz", ".npy"):
        return Source(given, rows=arrays.score_rows(given, arrays.arrays_of(given)))
    return Source(given, rows=read_curves(given))


def _log(given: Path, name: str, path: Path, columns: Columns) -> Log:
    label, run = label_and_run(name)
    group = given if run is None else Path(os.path.abspath(given)).parent
    return Log(label, run, group, given, path, columns)


def _runs_of(given: Path) -> list[tuple[str, Path, Columns]] | None:
    """Name, path and columns of each run; None of a file whose methods have labels."""
    if given.is_dir():
        return _of_folder(given)
    if columns := _of_files([given]):
        stem = given.name.removesuffix("monitor.csv").strip(".") if given.name.endswith("monitor.csv") else ""
        return [(name_of(given.parent, given.parent / stem), given, columns)]
    if given.suffix not in (".npz", ".npy") and " - " in (text := text_of(given)).partition("\n")[0]:
        table = text_tables.table_of(given, text)
        if text_tables.is_wandb(table.header):
            return [(name, given, columns) for name, columns in text_tables.wandb_runs(table)]
    return None


def _of_folder(root: Path) -> list[tuple[str, Path, Columns]]:
    runs = []
    for place, folders, names in os.walk(root):
        folders.sort()
        folder = Path(place)
        columns = _of_files([folder / name for name in sorted(names) if _is_log(name)])
        if columns:
            runs.append((name_of(root, folder), folder, columns))
    if not runs:
        is_results = (root / "manifest.json").exists()
        hint = "; a results folder of bojax stands without --csv" if is_results else ""
        raise ResultsError(f"{root}: has no curves; allowed: {FOLDER}{hint}")
    return runs


def _is_log(name: str) -> bool:
    return name.endswith("monitor.csv") or name in ("progress.csv", "evaluations.npz") or "tfevents" in name


def _of_files(paths: Sequence[Path]) -> Columns:
    """The columns of the files of one run; empty if none of them is a log of a run."""
    columns: Columns = {}
    monitors, events = [], [path for path in paths if "tfevents" in path.name]
    for path in paths:
        if path.suffix == ".npz":
            found = arrays.arrays_of(path)
            if "timesteps" in found and "results" in found:  # as `EvalCallback` writes them
                columns = {**columns, **arrays.evaluation_columns(path, found)}
        elif path.suffix == ".csv" and path not in events:
            text = text_of(path)
            if text.startswith("#{"):  # of Stable-Baselines3's `Monitor`: a comment in JSON, then CSV
                monitors.append((path, text))
            elif path.name.endswith("monitor.csv") and text_tables.is_bare_monitor(text):
                raise ResultsError(
                    f"{path}: lacks its first line #{{...}}; "
                    "allowed: # and JSON with t_start, as Monitor writes"
                )
            elif text_tables.PROGRESS_STEPS in text.partition("\n")[0]:
                columns = {**columns, **text_tables.progress_columns(text_tables.table_of(path, text))}
    if events:
        columns = {**event_columns(events[0].parent, events), **columns}
    return {**columns, **text_tables.monitor_columns(monitors)} if monitors else columns


def label_and_run(name: str) -> tuple[str, int | None]:
    """Split a name such as `ppo-seed-3` or `PPO_3`; the run is None if the name has no number of a run."""
    for pattern in _PATTERNS:
        if (match := pattern.fullmatch(name)) and len(match["run"]) < 10:
            return (match["label"] or "").strip("-_ ./"), int(match["run"])
    return name, None


def name_of(root: Path, place: Path) -> str:
    """The name of a run whose log is at `place`, in or below `root`: the path from there.

    If that is no label, as in `seed-3`, the names of the folders above precede it.
    """
    folder = Path(os.path.abspath(root))
    relative = place.relative_to(root).as_posix()
    name = "" if relative == "." else relative
    while not label_and_run(name)[0] and folder.name:
        name, folder = f"{folder.name}/{name}".strip("/"), folder.parent
    return name
