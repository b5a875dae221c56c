"""A command of `bojax`, in a process of its own or in this one, with its progress and its errors shown here.

A notebook may have started JAX with 64-bit numbers off and a single CPU device, which can no longer
be changed. A process of its own starts JAX as the command line does, and nothing changes in the caller's.
Classes that no other process can import need this one.
"""

import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import redirect_stderr, suppress
from dataclasses import dataclass
from typing import Any, TextIO

from rich.console import Console

from bojax.engine.bar import PROGRESS, Bar

_OF_TERMINALS = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""Environment variables with which rich takes a pipe for a terminal."""


_one_at_a_time = threading.RLock()
"""Held by a command in this process, which changes flags of JAX and the standard streams of all threads."""


@dataclass(frozen=True)
class CommandResult:
    """How a command ended."""

    code: int  # exit code; negative for a signal that ended the process
    lines: Sequence[str]  # what it printed

    @property
    def signal(self) -> signal.Signals | None:
        """The signal that ended the command; None if it ended otherwise."""
        number = -self.code if self.code < 0 else self.code - 128
        return signal.Signals(number) if number in {each.value for each in signal.Signals} else None

    @property
    def error(self) -> str:
        """The message of the last error in one line; without one, as after a traceback, the last line."""
        prefix = "error: "
        errors = [line for line in self.lines if line.startswith(prefix)]
        said = [line for line in self.lines if line.strip()]
        return (errors or said or [f"exit code {self.code}"])[-1].removeprefix(prefix)


class Output:
    """What a process prints: progress goes to a bar, messages are printed, errors are kept."""

    def __init__(self):
        self.lines: list[str] = []  # all but progress
        self._console = Console(stderr=True, highlight=False)
        self._bar: Bar | None = None
        self._title = ""
        self._is_printed = True

    def take(self, line: str) -> None:
        """Show a line."""
        event = None
        if line.startswith('{"title": '):
            with suppress(ValueError):
                event = json.loads(line)
        if event is not None:
            if self._bar is None or self._title != event["title"]:
                self.close()
                self._title = event["title"]
                self._bar = Bar(self._title, event["total"], self._console).__enter__()
            self._bar.show(event["done"], event["text"])
            return
        self.lines.append(line)
        # An error, a traceback and the command that resumes are part of the exception.
        if line.startswith(("error: ", "interrupted", "Traceback ")):
            self._is_printed = False
        if self._is_printed:
            (self._bar or Bar("", 0, self._console)).say(line)

    def close(self) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.__exit__(None, None, None)


def run_here(words: Sequence[str], config: str | None) -> CommandResult:
    """Run `bojax WORDS` in this process; JAX's flags are restored afterwards.

    The command reads the YAML `config` from standard input. A second Ctrl-C does not end the process, which
    is the caller's. Commands of several threads run one after another.

    Raises:
        ConfigError: A class does not accept its settings.
    """
    from bojax.cli.main import dispatch
    from bojax.engine.devices import restored
    from bojax.engine.signals import sparing_the_process

    with _one_at_a_time:
        shown: Any = _Shown(sys.stderr)
        stdin = sys.stdin
        sys.stdin = io.TextIOWrapper(io.BytesIO((config or "").encode()))
        try:
            with restored(), sparing_the_process(), redirect_stderr(shown):
                code = dispatch(list(words))
        except KeyboardInterrupt:
            code = 128 + signal.SIGINT
        finally:
            sys.stdin = stdin
    return CommandResult(code, shown.text.splitlines())


class _Shown:
    """A stream that keeps what is written to it."""

    def __init__(self, stream: TextIO):
        self._stream, self.text = stream, ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str, /) -> int:
        self.text += text
        return self._stream.write(text)


def run_in_child(words: Sequence[str], config: str | None) -> CommandResult:
    """Run `bojax WORDS` in a process of its own.

    It reads the YAML `config` from standard input. The first KeyboardInterrupt stops the sweep at a
    checkpoint, the second ends the process at once.
    """
    # The process writes to a pipe, even if a notebook sets variables that promise a terminal.
    inherited = {name: value for name, value in os.environ.items() if name not in _OF_TERMINALS}
    paths = [path for path in sys.path if path]
    output = Output()
    with subprocess.Popen(
        [sys.executable, "-m", "bojax", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**inherited, PROGRESS: "json", "PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,  # a notebook and a terminal send SIGINT to all processes of a group
    ) as process:
        try:
            assert process.stdin is not None and process.stdout is not None
            with suppress(BrokenPipeError), process.stdin:  # the process says why it has ended
                process.stdin.write((config or "").encode())
            while True:
                try:
                    for line in process.stdout:
                        output.take(line.decode(errors="backslashreplace").rstrip("\n"))
                    return CommandResult(process.wait(), output.lines)
                except KeyboardInterrupt:
                    process.send_signal(signal.SIGINT)
        finally:
            output.close()
            if process.poll() is None:  # an error of the display
                process.terminate()
