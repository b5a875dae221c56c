"""Signals such as SIGINT and SIGTERM: the first stops a sweep after its segment, the second exits at once.

`timeout` sends SIGTERM to a process and to its group, that is twice: what comes together counts once.
"""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What stops a sweep: Ctrl-C, the system or a scheduler, and a terminal that is closed."""

_ECHO_SECONDS = 0.2
"""Time after a first SIGTERM in which others count as the same."""

_ends_process = [True]


@contextlib.contextmanager
def sparing_the_process() -> Iterator[None]:
    """Keep a second signal from ending the process: a notebook has more to lose than a sweep."""
    _ends_process[0] = False
    try:
        yield
    finally:
        _ends_process[0] = True


class StopRequest:
    """Notices signals while its `with` block runs.

    Python runs signal handlers between bytecodes of the main thread, so during a long compilation a handler
    would have to wait. Instead, a thread reads signals from a wake-up socket. It needs the interpreter, which
    a library may hold forever; so soon after the main thread has noticed a signal, the system ends the
    process at the next. A second SIGHUP means nothing: the shell and the system may each send one when a
    terminal is closed.

    A signal that is ignored when the block begins stays ignored, as `nohup` asks for. `announce` is called
    with a message after the first signal, and prints it by default. The second signal ends the process if
    `exits`: by default, unless `sparing_the_process`.
    """

    def __init__(
        self,
        announce: Callable[[str], None] | None = None,
        signals: Sequence[signal.Signals] = SIGNALS,
        *,
        exits: bool | None = None,
    ):
        self.signum: int | None = None  # of the signal that requested the stop
        self._signals, self._exits = signals, _ends_process[0] if exits is None else exits
        self._announce = announce or (lambda text: print(text, file=sys.stderr, flush=True))

    def __bool__(self) -> bool:
        return self.signum is not None

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal: 129 for SIGHUP, 130 for SIGINT, 143 for SIGTERM."""
        return 128 + (self.signum or 0)

    def __enter__(self) -> "StopRequest":
        self._is_active = threading.current_thread() is threading.main_thread()
        if self._is_active:
            self._reader, self._writer = socket.socketpair()
            self._writer.setblocking(False)
            self._wakeup = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
            self._signals = [each for each in self._signals if signal.getsignal(each) is not signal.SIG_IGN]
            # Python writes a signal to the socket only if it has a handler.
            self._handlers = {number: signal.signal(number, self._handle) for number in self._signals}
            threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_active:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(self._wakeup)
            self._writer.close()  # the thread reads the end of the stream and ends

    def _handle(self, signum: int, _: object) -> None:
        for number in sorted(self._signals, key=lambda number: number == signum) if self._exits else ():
            if number == signum == signal.SIGTERM:
                time.sleep(_ECHO_SECONDS)
            signal.signal(number, signal.SIG_IGN if number == signal.SIGHUP else signal.SIG_DFL)

    def _watch(self) -> None:
        with self._reader:
            while received := self._reader.recv(1):
                number = received[0]
                if number not in self._signals:
                    continue
                if self.signum is not None and number == signal.SIGHUP:
                    continue
                if self.signum is not None and self._exits:
                    os._exit(128 + number)
                self.signum = number
                hint = "; repeat the signal to exit at once" if self._exits else ""
                self._announce(f"stopping after this segment{hint}")
                if number == signal.SIGTERM and self._exits:
                    self._drop_echo(received)

    def _drop_echo(self, received: bytes) -> None:
        """Take what has come of the same signal by now, however late this thread gets the interpreter."""
        time.sleep(_ECHO_SECONDS)
        self._reader.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while self._reader.recv(1, socket.MSG_PEEK) == received:
                self._reader.recv(1)
        self._reader.setblocking(True)


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """Context that a Ctrl-C leaves by a KeyboardInterrupt at its end.

    For code that imports JAX: there, a KeyboardInterrupt may be raised in a callback, which discards it.
    """
    with StopRequest(announce=lambda _: None, signals=(signal.SIGINT,), exits=False) as stop:
        yield
    if stop:
        raise KeyboardInterrupt


def stop_with_parent(parent: int | None = None, number: signal.Signals = signal.SIGTERM) -> threading.Thread:
    """Send this process a signal once the process that started it has ended, as when a kernel restarts.

    The id of that process, which may have ended already, is asked for now by default.
    """
    parent = parent or os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.kill(os.getpid(), number)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    return watcher
