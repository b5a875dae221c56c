"""SIGINT and SIGTERM: the first stops the sweep after its current segment, the second exits at once."""

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from types import TracebackType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Notices signals while its `with` block runs.

    Python runs signal handlers between bytecodes of the main thread, so during a long compilation a handler
    would have to wait. Instead, a thread reads signals from a wake-up socket.

    Attributes:
        signum: The signal that requested the stop; None before any signal.
    """

    def __init__(self, announce: Callable[[str], None] | None = None):
        self.signum: int | None = None
        self._announce = announce or (lambda text: print(text, file=sys.stderr, flush=True))

    def __bool__(self) -> bool:
        return self.signum is not None

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal: 130 for SIGINT, 143 for SIGTERM."""
        return 128 + (self.signum or 0)

    def __enter__(self) -> "StopRequest":
        self._is_active = threading.current_thread() is threading.main_thread()
        if self._is_active:
            self._reader, self._writer = socket.socketpair()
            self._writer.setblocking(False)
            self._wakeup = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
            # Python writes a signal to the socket only if it has a handler; these handlers do nothing.
            self._handlers = {number: signal.signal(number, lambda *_: None) for number in _SIGNALS}
            threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_active:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(self._wakeup)
            self._writer.close()  # the thread reads the end of the stream and ends

    def _watch(self) -> None:
        with self._reader:
            while received := self._reader.recv(1):
                number = received[0]
                if number not in _SIGNALS:
                    continue
                if self.signum is not None:
                    os._exit(128 + number)
                self.signum = number
                self._announce("stopping after this segment; repeat the signal to exit at once")
