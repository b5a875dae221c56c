"""A sweep in this process, for parts whose classes no other process can import."""

import io
import sys
from contextlib import redirect_stderr
from pathlib import Path
from typing import TextIO

from typing_extensions import override

from bojax.api.ended import Ended
from bojax.cli.running import resolved, run
from bojax.config.sweep import Sweep
from bojax.engine.devices import restored


def run_here(sweep: Sweep, out: Path, resume: bool, command: list[str]) -> Ended:
    """Run a sweep as the command line does; JAX's flags are restored afterwards.

    A second Ctrl-C does not end the process, which is the caller's.

    Raises:
        ConfigError: A class does not accept its settings.
    """
    shown = _Shown(sys.stderr)
    with restored(), redirect_stderr(shown):
        code = run([resolved(sweep)], [out], resume, command, exits=False)
    return Ended(code, shown.getvalue().splitlines())


class _Shown(io.StringIO):
    """Text that is also written to a stream."""

    def __init__(self, stream: TextIO):
        super().__init__()
        self._stream = stream

    @override
    def write(self, text: str, /) -> int:
        self._stream.write(text)
        return super().write(text)

    @override
    def flush(self) -> None:
        self._stream.flush()

    @override
    def isatty(self) -> bool:
        return self._stream.isatty()
