"""The entry point `bojax`: runs a command, and reports a user's mistake as one line and an exit code."""

import atexit
import contextlib
import errno
import faulthandler
import gc
import importlib
import io
import os
import signal
import stat
import sys
import threading
from collections.abc import Sequence
from typing import Any, NoReturn, TextIO, cast

from bojax import __version__, gpu_allocator
from bojax.cli.parser import Parser, UsageError
from bojax.config.errors import control_character, did_you_mean, say, shown
from bojax.errors import INPUT_ERROR, UserError

COMMANDS = {
    "list": ("listing", "list problems, planners and other parts, configs and sweeps"),
    "run": ("running", "run an experiment of configs/"),
    "sweep": ("running", "run a sweep of sweeps/ and write its report"),
    "reproduce": ("reproducing", "run the sweeps of a figure, a chapter or the whole thesis"),
    "status": ("status", "show which chunks of a sweep are done, running, lost or failed"),
    "worker": ("worker", "run chunks of a sweep that another process has started"),
    "report": ("reporting", "rebuild the figures, the verdicts and the page of results folders"),
    "best": ("best", "print the config of the best point of a sweep, and confirm its score"),
    "compare": ("comparing", "compare results folders and curves of other libraries on one page"),
    "export": ("exporting", "export results to CSV, TensorBoard, Weights & Biases or MLflow"),
    "tune": ("tuning", "search for the best settings by Bayesian optimisation"),
    "survey": ("survey", "plan the route of a survey over an area, beside the lawnmower"),
    "render": ("rendering", "draw a film or a still of a recorded run"),
    "bench": ("bench", "run benchmarks that compare bojax with other packages"),
    "doctor": ("doctor", "check versions, devices, precision and folders"),
}
"""The module and the summary of each command."""

_WRITING = ("run", "sweep", "reproduce", "tune")
"""Commands whose results are files, which they finish even if their output cannot be written."""

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors of a disk; those that name no file are of standard output."""

YOUNG_OBJECTS = 50_000
"""Number of new objects after which Python searches them for cycles.

Imports and tracing make millions of objects, and few of them are in cycles. By default, Python searches after
every 700 (2,000 from Python 3.13), which takes a tenth of the time in which a sweep starts.
"""

_EXAMPLES = """\
  bojax sweep parking                       the parking study: four planners, 200 runs each
  bojax sweep parking --runs 20             the same with 20 runs each
  bojax run parking planner.iterations=100  one experiment, with a setting changed
  bojax reproduce chapter4                  the sweeps of a chapter of the thesis, with one page over all
  bojax list kcbts                          the settings of a planner
"""


class Messages:
    """An output stream whose errors are only noted: a log on a full disk must not stop a sweep."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self.error: OSError | None = None  # the last one

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str, /) -> int:
        """Write a text, if that is possible."""
        try:
            self._stream.write(text)
        except OSError as error:
            self.error = error
        return len(text)

    def flush(self) -> None:
        """Write what is left, if that is possible."""
        try:
            self._stream.flush()
        except OSError as error:
            self.error = error


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 for success, 2 for a mistake in the input."""
    words = list(sys.argv[1:] if argv is None else argv)
    # Set before NumPy is imported. Runs are computed in parallel, and threads within small factorisations
    # compete for the same cores (200 of size 200 x 200 on 2 busy cores: 1 thread 0.2 s, 2 threads 7.6 s).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gpu_allocator.choose()
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of folders may not be UTF-8
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        return _run_to_the_end(words) if words and words[0] in _WRITING else dispatch(words)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            say(f"error: {error.filename}: {error.strerror}")
            return INPUT_ERROR
        is_closed = isinstance(error, BrokenPipeError)
        if not is_closed and (error.filename is not None or error.errno not in _DISK):
            raise
        return _end_output(error)
    except UserError as error:
        say(f"error: {error}")
        return error.exit_code
    except ValueError as error:
        if "jax" in sys.modules or not any(name.startswith("jax.") for name in sys.modules):
            raise
        say(f"error: JAX refuses its environment variables: {error}")
        return INPUT_ERROR


def _run_to_the_end(words: list[str]) -> int:
    """Run a command that goes on if its output cannot be written."""
    if sys.stdout is None:  # bojax ... >&-
        return dispatch(words)
    output = Messages(sys.stdout)
    with contextlib.redirect_stdout(cast(TextIO, output)):
        code = dispatch(words)
    output.flush()
    return code if output.error is None else code or _end_output(output.error)


def _end_output(error: OSError) -> int:
    """Give up standard output, which Python would write to again on exit, and return the exit code."""
    output = sys.stdout.fileno()
    # Nobody reads any more: `bojax list | head`, or a terminal that was closed under `nohup bojax ...`.
    is_closed_terminal = error.errno == errno.EIO and stat.S_ISCHR(os.fstat(output).st_mode)
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    if isinstance(error, BrokenPipeError) or is_closed_terminal:
        return 0
    print(f"error: standard output cannot be written: {error.strerror}", file=sys.stderr)
    return 1


def entry() -> None:
    """Run the command of `sys.argv` and exit, with the code 1 after the traceback of an unexpected error.

    `kill -USR1 PID` prints where each thread is, should a command not go on.
    """
    gc.set_threshold(YOUNG_OBJECTS)
    # A notebook passes on the backend of its kernel, which the environment of bojax may lack.
    os.environ.update(MPLBACKEND="agg", MATPLOTLIBRC=os.devnull)
    _open_standard_streams()
    if sys.stderr is not None:
        sys.stderr = cast(TextIO, Messages(sys.stderr))
    if hasattr(signal, "SIGUSR1"):
        faulthandler.register(signal.SIGUSR1, file=2)
    try:
        code = main()
    except Exception as error:
        sys.excepthook(type(error), error, error.__traceback__)
        code = 1
    leave(code)


def _open_standard_streams() -> None:
    """Open the null device in place of a standard stream that is closed.

    The next file would take the place, and libraries that write to standard error would write into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def leave(code: int) -> NoReturn:
    """End the process.

    Python would free programs and arrays one by one, which takes half a second, and longer with a GPU. A
    process that has imported JAX therefore calls the functions of `atexit` and leaves the rest to the
    operating system. Daemon threads that are still alive may be inside XLA or CUDA, where Python cannot end:
    the process then leaves at once, without the functions of `atexit`.
    """
    # The command is over: a Ctrl-C ends the process, and does not interrupt what Python does on exit.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    others = [thread for thread in threading.enumerate() if thread is not threading.current_thread()]
    is_alone = "jax" in sys.modules and not others
    if is_alone:
        atexit._run_exitfuncs()
    if is_alone or any(thread.daemon for thread in others):
        with contextlib.suppress(OSError):  # Python flushes again on exit, and reports it
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()
            os._exit(code)
    sys.exit(code)


def dispatch(words: list[str]) -> int:
    """Run a command in this process, changing nothing of it, and return the exit code.

    Raises:
        UsageError: The command line is wrong; other errors of a user are those of the input.
    """
    if sys.platform == "win32":  # has neither the locks of files nor the signals that sweeps need
        raise UsageError("bojax runs on Linux and macOS; on Windows, use WSL")
    for word in words:
        if sign := control_character(word):
            raise UsageError(
                f"command line: got {shown(word)}; allowed: UTF-8 text without the character {sign}"
            )
    name = words[0] if words else "--help"
    if name in ("--help", "-h"):
        _parser().print_help()
        return 0
    if name == "--version":
        print(f"bojax {__version__}")
        return 0
    if name not in COMMANDS:
        kind = "option" if name.startswith("-") else "command"
        allowed = ", ".join(sorted(COMMANDS))
        raise UsageError(f"unknown {kind} {name}; allowed: {allowed}{did_you_mean(name, COMMANDS)}")
    try:
        os.getcwd()
    except OSError as error:
        raise UsageError(
            "the working directory has been deleted or cannot be read; change to another"
        ) from error
    return importlib.import_module(f"bojax.cli.{COMMANDS[name][0]}").main(name, words[1:])


def _parser() -> Parser:
    commands = "\n".join(f"  {name:<9} {summary}" for name, (_, summary) in COMMANDS.items())
    about = "Batch experiments in Bayesian optimisation for planning and reinforcement learning.\n\n"
    about += f"commands:\n{commands}\n\nbojax COMMAND --help describes a command."
    return Parser("", "COMMAND ...", about, _EXAMPLES)
