"""How a command ended."""

import signal
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: Exit code; negative for a signal that ended the process.
        lines: What it printed.
    """

    code: int
    lines: Sequence[str]

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

    @property
    def output(self) -> str:
        """All that it printed."""
        return "\n".join(self.lines)
