"""The command line in a process of its own, with its progress and its errors shown here.

A notebook may have started JAX with 64-bit numbers off and a single CPU device, which can no longer
be changed. A process of its own starts JAX as the command line does, and nothing changes in the caller's.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from rich.console import Console

from bojax.api.ended import Ended
from bojax.engine.bar import PROGRESS, Bar

_OF_TERMINALS = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""Environment variables with which rich takes a pipe for a terminal."""


class Output:
    """What a process prints: progress goes to a bar, messages are printed, errors are kept.

    Attributes:
        lines: All lines but those of progress.
    """

    def __init__(self):
        self.lines: list[str] = []
        self._console = Console(stderr=True, highlight=False)
        self._bar: Bar | None = None
        self._is_printed = True

    def take(self, line: str) -> None:
        """Show a line."""
        if (event := _event(line)) is not None:
            if self._bar is None:
                self._bar = Bar(event["title"], event["total"], self._console).__enter__()
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


def run_command(words: Sequence[str], config: str | None) -> Ended:
    """Run `bojax WORDS`.

    The first KeyboardInterrupt stops the sweep at a checkpoint, the second ends the process at once.

    Args:
        words: The words of the command line.
        config: YAML that the process reads from standard input.
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
            _feed(process, config or "")
            while True:
                try:
                    assert process.stdout is not None
                    for line in process.stdout:
                        output.take(line.decode(errors="backslashreplace").rstrip("\n"))
                    return Ended(process.wait(), output.lines)
                except KeyboardInterrupt:
                    process.send_signal(signal.SIGINT)
        finally:
            output.close()
            if process.poll() is None:  # an error of the display
                process.terminate()


def _feed(process: subprocess.Popen[bytes], text: str) -> None:
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin:  # the process says why it has ended
        process.stdin.write(text.encode())


def _event(line: str) -> Mapping[str, Any] | None:
    """The progress that a line tells; None for a message."""
    if not line.startswith('{"title": '):
        return None
    try:
        return json.loads(line)
    except ValueError:
        return None
