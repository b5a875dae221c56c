"""`bojax.run`, `bojax.sweep` and `bojax.tune`: the commands of the same names, from Python."""

import contextlib
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from bojax.api.command import run_here, run_in_child
from bojax.api.errors import BojaxError, Interrupted, in_one_line
from bojax.api.plain_values import PlainValues, path_of
from bojax.api.results import Results, TuningResults, load
from bojax.config.errors import ConfigError, shown
from bojax.config.files import STANDARD_INPUT
from bojax.config.overrides import SOURCE
from bojax.config.sweep import load_config, load_sweep
from bojax.config.sweep_file import UNNAMED
from bojax.results.folder import is_unfinished, reserve_folder
from bojax.results.store import MANIFEST
from bojax.tuning.ranges import split_ranges

ConfigSource = str | os.PathLike[str] | Mapping[str, Any]
"""A name, the path of a YAML file, or the content of one."""

Folder = str | os.PathLike[str]


def run(
    config: ConfigSource,
    /,
    *,
    runs: int | None = None,
    seed: int | None = None,
    out: Folder | None = None,
    resume: bool = False,
    **settings: Any,
) -> Results:
    """Run one experiment, as `bojax run`, and return its results.

    The experiment runs in a process of its own, with progress shown here; nothing changes in this process.
    Modules that a config names are found in the working directory and in `sys.path`. Ctrl-C stops the
    experiment at a checkpoint, a second one at once.

    A part may be a class of your own, such as `{"env": Pond}`, also one that is defined in the notebook. The
    experiment then runs in this process, since the class does not exist in another one. JAX starts here if it
    has not started yet. Its flags are restored afterwards.

    Args:
        config: Name of a config, such as `"parking"`, path of a YAML file, or its content as a mapping.
        runs: Number of runs; as in the config by default.
        seed: Seed of all runs; as in the config by default.
        out: Results folder, new or empty; `results/NAME/TIME` by default.
        resume: Whether to continue the unfinished run in `out`, or by default the newest unfinished one.
        settings: Settings to change, by dotted path: `run("parking", **{"planner.iterations": 50})`.

    Raises:
        BojaxError: The input is wrong, or the experiment failed; the message is one line.
        Interrupted: It was stopped by Ctrl-C; a `KeyboardInterrupt` whose message says how to resume.
    """
    return load(_start("run", config, {"runs": runs, "seed": seed}, out, resume, settings))


def sweep(
    sweep: ConfigSource,
    /,
    *,
    runs: int | None = None,
    seed: int | None = None,
    out: Folder | None = None,
    resume: bool = False,
    **settings: Any,
) -> Results:
    """Run a sweep, as `bojax sweep`, and return its results.

    The process and the arguments are as in `bojax.run`, with the name or content of a sweep: `runs` is the
    number of runs of each point.

    Raises:
        BojaxError: The input is wrong, or the sweep failed; the message is one line.
        Interrupted: It was stopped by Ctrl-C; a `KeyboardInterrupt` whose message says how to resume.
    """
    return load(_start("sweep", sweep, {"runs": runs, "seed": seed}, out, resume, settings))


def tune(
    config: ConfigSource,
    ranges: Mapping[str, Sequence[Any]],
    /,
    *,
    metric: str | None = None,
    minimise: bool = False,
    budget: int | None = None,
    batch: int | None = None,
    confirm: int | None = None,
    runs: int | None = None,
    seed: int | None = None,
    out: Folder | None = None,
    resume: bool = False,
    **settings: Any,
) -> TuningResults:
    """Search for the best values of settings, as `bojax tune`, and return what was found.

    The process and the other arguments are as in `bojax.run`; those without a default here have the one of
    the command line.

    Args:
        config: Name of a config, path of a YAML file, or its content as a mapping.
        ranges: Bounds of each tuned setting, by dotted path: `{"planner.exploration": (10, 1000, "log")}`;
            with `"log"`, values are searched on a logarithmic scale. A list has choices:
            `{"planner": ["kcbts", "sbo"]}`.
        metric: Column of `runs.parquet` whose mean is the score.
        minimise: Whether less is better, as it always is of a time such as `steps_to_goal`.
        budget: Number of runs of the search in all.
        batch: Number of points of a round.
        confirm: Number of fresh runs of each of the best three settings; 0 for none.
        runs: Number of runs of each point.
        seed: Seed of the search and of its runs.
        out: Folder of the search, new or empty; `results/NAME-tune/TIME` by default.
        resume: Whether to continue an unfinished search, or to extend the finished one in `out`.
        settings: Settings to change that are not tuned, by dotted path.

    Raises:
        BojaxError: The input is wrong, or a round failed; the message is one line.
        Interrupted: It was stopped by Ctrl-C; a `KeyboardInterrupt` whose message says how to resume.
    """
    options = {"metric": metric, "minimise": minimise or None, "budget": budget, "batch": batch}
    options |= {"confirm": confirm, "runs": runs, "seed": seed}
    return TuningResults(_start("tune", config, options, out, resume, settings, ranges))


def _start(
    command: Literal["run", "sweep", "tune"],
    given: ConfigSource,
    options: Mapping[str, Any],
    out: Folder | None,
    resume: bool,
    settings: Mapping[str, Any],
    ranges: Mapping[str, Sequence[Any]] | None = None,
) -> Path:
    """Run a command with options and settings, and return its results folder."""
    values = PlainValues()
    with in_one_line():
        options = {name: values.number(value, name) for name, value in options.items() if value is not None}
        if isinstance(given, Mapping):
            source = values.mapping(given, str(UNNAMED))
        else:
            source = path_of(given, command, "a name, a path or a mapping")
        place = None if out is None else Path(path_of(out, "out"))
        overrides = [f"{key}={values.text(value, (key,), SOURCE)}" for key, value in settings.items()]
        tuned = [_range(key, bounds, values) for key, bounds in (ranges or {}).items()]
        # A mistake ends here, before a process starts and before anything is written.
        split_ranges(tuned)
        load_it = load_sweep if command == "sweep" else load_config
        name = load_it(source, overrides, options.get("runs"), options.get("seed")).name
        name = f"{name}-tune" if command == "tune" else name
        if place is not None and resume and command == "tune" and place.is_dir():
            folder = place  # of a search, which may be finished
        else:
            folder, _ = reserve_folder(name, place, resume=resume)
    words = [command, source if isinstance(source, str) else STANDARD_INPUT, *overrides, *tuned]
    for option, value in {**options, "out": folder}.items():
        words += [f"--{option}"] if value is True else [f"--{option}", str(value)]
    words += ["--resume"] if resume else []
    config = None if isinstance(source, str) else values.text(source, (), str(UNNAMED))
    try:
        with in_one_line():
            ended = (run_here if values.has_classes else run_in_child)(words, config)
    finally:
        with contextlib.suppress(OSError):  # unless something was written
            folder.rmdir()
    if ended.code == 0:
        return folder
    if ended.signal is None:
        raise BojaxError(ended.error.removeprefix(f"{SOURCE}: "), "\n".join(ended.lines))
    advice = "nothing was written"
    if is_unfinished(folder):
        again = {**options, "out": str(folder), "resume": True}
        advice = f"to resume: {_call(command, given, ranges, again, settings)}"
    elif (folder / MANIFEST).exists():
        advice = f"the runs are finished; to write the report: bojax report {folder}"
    if ended.signal is signal.SIGINT:
        raise Interrupted(f"interrupted; {advice}")
    reason = f"the process of the sweep was ended by {ended.signal.name}"
    raise BojaxError(f"{reason}; {advice}", "\n".join(ended.lines))


def _range(key: str, bounds: Any, values: PlainValues) -> str:
    """A range or choices as a word of the command line: `key=low:high`, `key=low:high:log` or `key=a,b`."""
    given = values.number(bounds, key)
    if isinstance(bounds, list):
        words = [each if isinstance(each, str) else values.text(each, (key,), SOURCE) for each in given]
        if len(words) < 2 or any(set(word) & set(",[]{}\"'") for word in words):
            raise ConfigError(
                f"{key}: got {shown(given)}; allowed: at least two numbers, or texts without commas"
            )
        return f"{key}={','.join(words)}"
    low, high, *scale = given if isinstance(given, list) and len(given) in (2, 3) else (None, None)
    if not all(isinstance(bound, int | float) for bound in (low, high)) or scale not in ([], ["log"]):
        raise ConfigError(
            f'{key}: got {shown(given)}; allowed: (low, high) or (low, high, "log"), two numbers, '
            "or a list of choices"
        )
    return ":".join([f"{key}={low}", str(high), *scale])


def _call(
    command: str,
    given: ConfigSource,
    ranges: Mapping[str, Any] | None,
    options: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> str:
    """The call of a function, as text."""
    first = ["config" if isinstance(given, Mapping) else repr(os.fspath(given))]
    first += [repr(dict(ranges))] if ranges is not None else []
    named = [f"{name}={value!r}" for name, value in options.items()]
    rest = [f"**{dict(settings)!r}"] if settings else []
    return f"bojax.{command}({', '.join([*first, *named, *rest])})"
