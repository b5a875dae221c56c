"""The entry point `bojax`: picks the command, and turns a user's mistake into one line and an exit code."""

import errno
import importlib
import io
import os
import sys
from collections.abc import Sequence

from bojax import __version__
from bojax.cli.parser import Parser, UsageError
from bojax.config.errors import control_character, one_of, printable, shown

COMMANDS = {
    "list": ("listing", "what there is: problems, planners, configs, sweeps"),
    "run": ("running", "run one experiment of configs/"),
    "sweep": ("running", "run a sweep of sweeps/ and write its report"),
    "report": ("reporting", "figures, tables and claims of results folders"),
    "render": ("rendering", "a film of a recorded run, or a still"),
    "bench": ("bench", "the benchmarks, each beside its peer"),
    "doctor": ("doctor", "what works here: versions, devices, precision, folders"),
}
"""Name of each command, with the module that holds it and what it does."""

_EXAMPLES = """\
  bojax sweep parking                       the parking study: four planners, 200 runs each
  bojax sweep parking --runs 20             a quick look at it
  bojax run parking planner.iterations=100  one experiment, with a setting changed
  bojax list kcbts                          the settings of a planner
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0, 2 for a mistake in the input, or the command's own."""
    words = list(sys.argv[1:] if argv is None else argv)
    # Before NumPy is imported: runs are what is parallel here, and threads within a small factorisation fight
    # for their cores (200 of 200 x 200 on two busy cores: 0.2 s with one thread, 7.6 s with two).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):  # a folder's name need not be text in UTF-8
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        return _run(words)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `bojax list | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        print(printable(f"error: {error.filename}: {error.strerror}"), file=sys.stderr)
        return UsageError.exit_code
    except Exception as error:
        code = getattr(error, "exit_code", None)
        if code is None:
            raise
        print(printable(f"error: {error}"), file=sys.stderr)
        return code


def _run(words: list[str]) -> int:
    for word in words:
        if sign := control_character(word):
            raise UsageError(f"{shown(word)}: an argument is text in UTF-8 without the character {sign}")
    name = words[0] if words else "--help"
    if name in ("--help", "-h"):
        _parser().print_help()
        return 0
    if name == "--version":
        print(f"bojax {__version__}")
        return 0
    if name not in COMMANDS:
        kind = "option" if name.startswith("-") else "command"
        raise UsageError(f"unknown {kind} {name}{one_of(name, COMMANDS)}")
    module = importlib.import_module(f"bojax.cli.{COMMANDS[name][0]}")
    return module.main(name, words[1:])


def _parser() -> Parser:
    commands = "\n".join(f"  {name:<8} {summary}" for name, (_, summary) in COMMANDS.items())
    return Parser(
        prog="bojax",
        usage="bojax COMMAND ...",
        description="Batch experiments in Bayesian optimisation for planning and reinforcement learning.\n\n"
        f"commands:\n{commands}\n\nbojax COMMAND --help tells more about a command.",
        examples=_EXAMPLES,
    )
