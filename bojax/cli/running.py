"""`bojax run` and `bojax sweep`: validating the input, running it and writing the report."""

import os
import re
import sys
from argparse import Namespace
from collections.abc import Sequence
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

from bojax.cli.launching import (
    INLINE,
    LAUNCHING_USAGE,
    add_launching,
    add_running,
    check_launching,
    dry_run,
    launcher_of,
)
from bojax.cli.parser import Parser, UsageError
from bojax.config.errors import say
from bojax.config.files import STANDARD_INPUT, SUFFIXES, display, find, shadowed
from bojax.config.overrides import parse_overrides
from bojax.config.points import Sweep
from bojax.config.sweep import load_config, load_sweep
from bojax.config.sweep_file import Source
from bojax.config.yaml_file import MAX_BYTES, mapping_of
from bojax.engine.resolve import resolved

_DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")

_OVERRIDES = """\
key=value changes a setting by its dotted path, as in planner.iterations=100 problem=parking record.runs=2.
Values are YAML. A new kind (planner=sbo) discards the settings of the old kind. The order has no effect.
Results are written to results/NAME/TIME, or to --out. Existing results are never overwritten.
"""

_RUN = (
    "CONFIG",
    "a file, or a name in configs/",
    "Run one experiment.",
    """\
  bojax run parking                                  configs/parking.yaml
  bojax run my.yaml planner=sbo planner.depth=2      a file, with two settings changed
  bojax run parking problem=mine:Field --runs 4      a custom problem, class Field of mine.py
  bojax run - --runs 4 < my.yaml                     a config from standard input
""",
)

_SWEEP = (
    "SWEEP",
    "files, or names in sweeps/",
    "Run sweeps and write their reports.",
    """\
  bojax sweep parking                                sweeps/parking.yaml
  bojax sweep fig-4.2 fig-4.6 --out results/paper    two sweeps, in results/paper/fig-4.2 and .../fig-4.6
  bojax sweep parking --runs 20 planner.iterations=50
  bojax sweep parking --resume                       resume the newest unfinished sweep
""",
)
"""Metavar, source, summary and examples of the commands."""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command `name`, which is "run" or "sweep"."""
    args = _parser(name).read(words)
    check_launching(args)
    overrides, sources = split_words(args.words)
    for word, value in pairwise(sources):
        if _DOTTED.fullmatch(word) and not word.endswith(SUFFIXES):
            raise UsageError(f"bojax {name}: got {word} {value}; did you mean {word}={value}?")
    if not sources or (name == "run" and len(sources) > 1):
        allowed = "one config" if name == "run" else "one sweep or more"
        got = ", ".join(sources) or "none"
        raise UsageError(f"bojax {name}: got {got}; allowed: {allowed} (bojax list shows the names)")
    if sources.count(STANDARD_INPUT) > 1:
        raise UsageError(f"bojax {name}: got {STANDARD_INPUT} twice; allowed: distinct sweeps")
    given = [read_source(source) for source in sources]
    load = load_config if name == "run" else load_sweep
    sweeps = [load(source, overrides, args.runs, args.seed) for source in given]
    names = [sweep.name for sweep in sweeps]
    if duplicates := {each for each in names if names.count(each) > 1}:
        raise UsageError(f"bojax {name}: got {min(duplicates)} twice; allowed: distinct sweeps")
    folder = "configs" if name == "run" else "sweeps"
    for source in given:
        if isinstance(source, str) and (hidden := shadowed(source, folder)):
            say(f"note: {display(find(source, folder))} hides {hidden}, which differs")
    for sweep in sweeps:
        _note_doubts(sweep)
    folders = [args.out / each for each in names] if args.out and len(names) > 1 else [args.out] * len(names)
    if args.dry_run:
        from bojax.results.folder import choose_folder  # imports pyarrow

        pairs = zip(names, folders, strict=True)
        return dry_run(args, names, [choose_folder(*pair, resume=args.resume)[0] for pair in pairs])
    command = ["bojax", name, *words]
    sweeps = [resolved(sweep) for sweep in sweeps]
    return run(sweeps, folders, args.resume, command, launching=args, has_baseline=name == "run")


def _note_doubts(sweep: Sweep) -> None:
    """Print a note on standard error on the first point whose settings are probably a mistake."""
    for point in sweep.points:
        if doubt := _doubt(point.config):
            print(f"note: {doubt}", file=sys.stderr)
            return


def _doubt(config: Any) -> str:
    """What is probably a mistake in the settings of a point; empty if nothing is."""
    env, problem, planner = (getattr(config, part, None) for part in ("env", "problem", "planner"))
    if getattr(config, "stop", "") == "first-success" and getattr(env, "success", "") == "never":
        return 'env.success: got "never": no run ends before its last episode, or counts as a success'
    paths, domain = getattr(planner, "motions", planner), getattr(problem, "domain", None)
    length, name = getattr(paths, "length", 0.0), "length" if paths is planner else "motions.length"
    if domain is not None and length > (side := max(domain[2] - domain[0], domain[3] - domain[1])):
        return f"planner.{name}: got {length:g} m: such paths may leave the domain, which is {side:g} m wide"
    return ""


def _parser(name: str) -> Parser:
    is_run = name == "run"
    metavar, source, about, examples = _RUN if is_run else _SWEEP
    usage = f"{metavar}{'' if is_run else '...'} [key=value ...] [--runs N] [--seed S] [--out DIR] [--resume]"
    usage += "" if is_run else LAUNCHING_USAGE
    parser = Parser(name, usage, f"{about}\n\n{_OVERRIDES}", examples)
    help = f"{source}; {STANDARD_INPUT} for standard input; with key=value settings"
    parser.option("words", metavar, help, nargs="*")
    out = "results folder, new or empty (default: results/NAME/TIME)"
    add_running(parser, out, "resume an interrupted or failed sweep")
    if not is_run:
        add_launching(parser)
    return parser


def split_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The overrides among the words of a command line, and the sources.

    Raises:
        ConfigError: An override is wrong. The shell may have split a value into words, which are no sources.
    """
    overrides = [word for word in words if "=" in word and not os.path.isfile(word)]
    parse_overrides(overrides)
    return overrides, [word for word in words if word not in overrides]


def read_source(word: str) -> Source:
    """A name or a path as it is, or the content of a YAML file on standard input."""
    if word != STANDARD_INPUT:
        return word
    return mapping_of(sys.stdin.buffer.read(MAX_BYTES + 1), "standard input")


def run(
    sweeps: Sequence[Sweep],
    folders: Sequence[Path | None],
    resume: bool,
    command: list[str],
    *,
    launching: Namespace = INLINE,
    reports: bool = True,
    has_baseline: bool = False,
) -> int:
    """Run resolved sweeps, write their reports, and return the exit code of `bojax.engine.run.run_sweeps`.

    A folder is None for `results/NAME/TIME`. `launching` has the options of `add_launching`. Without
    `reports`, a sweep ends with its tables. With `has_baseline`, random actions are run beside a learner.
    """
    from bojax.engine.signals import StopRequest, stop_with_parent

    # During the import of JAX, a callback can raise a KeyboardInterrupt, which is discarded there.
    with StopRequest(announce=lambda _: None) as stop:
        from bojax.engine.devices import start_early

        if launching.launcher == "inline" and len({sweep.engine.device for sweep in sweeps}) == 1:
            start_early(sweeps[0].engine.device)
        from bojax.engine.bar import is_read_by_a_process
        from bojax.engine.run import run_sweeps
        from bojax.engine.targets import Request
    if stop:
        print("interrupted", file=sys.stderr)
        return stop.exit_code

    from bojax.cli.background import Reports
    from bojax.engine.baseline import write_baseline

    if is_read_by_a_process():
        stop_with_parent()
    launcher, devices = launcher_of(launching)
    with launcher or nullcontext(), Reports(in_background=reports and len(sweeps) > 1) as writer:

        def finish(folder: Path) -> None:
            if has_baseline:
                write_baseline(sweeps[0], folder)
            writer.write(folder)

        code = run_sweeps(
            [Request(sweep, folder) for sweep, folder in zip(sweeps, folders, strict=True)],
            resume,
            command,
            finish=finish if reports else lambda _: None,
            launcher=launcher,
            indices=devices,
            planned=writer.prepare if reports else lambda: None,
        )
        if code >= 128:
            writer.stop()
    return code or writer.exit_code
