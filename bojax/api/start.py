"""`bojax.run` and `bojax.sweep`: the commands of the same names, from Python."""

import contextlib
import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from bojax.api.errors import BojaxError, Interrupted, in_one_line
from bojax.api.given import Values, path_of
from bojax.api.results import Results, load
from bojax.config.files import STANDARD_INPUT
from bojax.config.overrides import SOURCE
from bojax.config.sweep import UNNAMED, load_config, load_sweep
from bojax.results.folder import is_unfinished, reserve_folder
from bojax.results.store import MANIFEST

Given = str | os.PathLike[str] | Mapping[str, Any]
"""A name, the path of a YAML file, or the content of one."""


def run(
    config: Given,
    /,
    *,
    runs: int | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
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
    return _start("run", config, runs, seed, out, resume, settings)


def sweep(
    sweep: Given,
    /,
    *,
    runs: int | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    **settings: Any,
) -> Results:
    """Run a sweep, as `bojax sweep`, and return its results.

    The process and the arguments are those of `bojax.run`, with the name or content of a sweep: `runs` is the
    number of runs of each point.

    Raises:
        BojaxError: The input is wrong, or the sweep failed; the message is one line.
        Interrupted: It was stopped by Ctrl-C; a `KeyboardInterrupt` whose message says how to resume.
    """
    return _start("sweep", sweep, runs, seed, out, resume, settings)


def _start(
    command: Literal["run", "sweep"],
    given: Given,
    runs: int | None,
    seed: int | None,
    out: str | os.PathLike[str] | None,
    resume: bool,
    settings: Mapping[str, Any],
) -> Results:
    values = Values()
    with in_one_line():
        runs, seed = values.number(runs, "runs"), values.number(seed, "seed")
        if isinstance(given, Mapping):
            source = values.mapping(given, str(UNNAMED))
        else:
            source = path_of(given, command, "a name, a path or a mapping")
        place = None if out is None else Path(path_of(out, "out"))
        overrides = [f"{key}={values.text(value, (key,), SOURCE)}" for key, value in settings.items()]
        # A mistake ends here, before a process starts and before anything is written.
        load_it = load_config if command == "run" else load_sweep
        loaded = load_it(source, overrides, runs, seed)
        folder, _ = reserve_folder(loaded.name, place, resume=resume)
    words = ["bojax", command, source if isinstance(source, str) else STANDARD_INPUT, *overrides]
    for option, value in (("--runs", runs), ("--seed", seed), ("--out", folder)):
        words += [] if value is None else [option, str(value)]
    words += ["--resume"] if resume else []
    try:
        if values.has_classes:
            from bojax.api.here import run_here

            with in_one_line():
                ended = run_here(loaded, folder, resume, words)
        else:
            from bojax.api.child import run_command

            config = None if isinstance(source, str) else values.text(source, (), str(UNNAMED))
            ended = run_command(words[1:], config)
    finally:
        with contextlib.suppress(OSError):  # unless something was written
            folder.rmdir()
    if ended.code == 0:
        return load(folder)
    if ended.signal is None:
        raise BojaxError(ended.error.removeprefix(f"{SOURCE}: "), ended.output)
    advice = "nothing was written"
    if is_unfinished(folder):
        options = {"runs": runs, "seed": seed, "out": str(folder), "resume": True}
        advice = f"to resume: {_call(command, given, options, settings)}"
    elif (folder / MANIFEST).exists():
        advice = f"the runs are finished; to write the report: bojax report {folder}"
    if ended.signal is signal.SIGINT:
        raise Interrupted(f"interrupted; {advice}")
    raise BojaxError(f"the process of the sweep was ended by {ended.signal.name}; {advice}", ended.output)


def _call(command: str, given: Given, options: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """The call of a function, as text."""
    first = "config" if isinstance(given, Mapping) else repr(os.fspath(given))
    named = [f"{name}={value!r}" for name, value in options.items() if value is not None]
    rest = [f"**{dict(settings)!r}"] if settings else []
    return f"bojax.{command}({', '.join([first, *named, *rest])})"
