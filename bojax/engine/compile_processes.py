"""Processes that compile programs beside the one that runs them.

Tracing and lowering hold Python's interpreter lock, so that one process compiles a hundred groups hardly
faster than one after the other, and its running chunks wait meanwhile. Where many groups are to be compiled,
each is compiled in one of several child processes, which leave the traced programs in `program_cache`, the
compiled ones in JAX's cache, and the choices of kernels in the folder of the plan. The parent then loads them
from there. What a child cannot do, the parent does as if there were no children.

They are no pool of `multiprocessing`: its processes would import the user's script anew, and start its sweep.
"""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import IO, Any, NamedTuple

import jax

import bojax
from bojax.engine.autotuning import Choices
from bojax.engine.batch import Functions, Programs
from bojax.engine.compiler import compile_threads
from bojax.engine.devices import Device, all_settings, of_platform, prepare, setting
from bojax.engine.groups import StaticGroup
from bojax.engine.plan import Plan
from bojax.engine.storage import Storage
from bojax.engine.tasks import ProgramKey, longest_first, tasks_of
from bojax.engine.xla_choices import offer_shipped
from bojax.numerics.cores import usable_cores
from bojax.numerics.disk_cache import folder_of

LEAST_GROUPS = 8
"""Number of groups to compile from which child processes are worth their start, of some 6 s each on a GPU."""

LEAST_CORES = 8
"""Number of cores from which child processes do not take them from XLA's own threads."""

_BYTES_OF_CHILD = 2 << 30
"""Memory that a child process may take on a GPU: the context of CUDA, and what is measured there."""

_JAX_FRACTION = 0.75
"""Share of a GPU's memory that JAX takes, unless XLA_PYTHON_CLIENT_MEM_FRACTION says otherwise."""


class Request(NamedTuple):
    """The programs of a group for a number of lanes."""

    kind: type[Programs]  # the class of the programs
    group: StaticGroup
    device: tuple[str, int]  # platform and index of the device, which all clients of a GPU have in common
    num_lanes: int
    seed: int  # seed of the sweep
    recorded: int  # largest number of recorded runs of a chunk
    wider: int | None  # the larger number of lanes that the runs come from; None if they start in these lanes
    choices: Path | None  # folder of the plan's choices of kernels; None if nothing is kept
    key: str | None  # name of the programs in `program_cache`

    @classmethod
    def of(cls, programs: ProgramKey) -> "Request":
        """The request for programs of a task."""
        task, device, width = programs
        return cls(
            kind=task.kind,
            group=task.group,
            device=(device.platform, device.local_hardware_id),
            num_lanes=width,
            seed=task.seed,
            recorded=task.recorded,
            wider=task.layout.wider(width),
            choices=task.storage.choices and task.storage.choices.folder,
            key=programs.name,
        )


def number_of_processes(num_groups: int, devices: Sequence[Device]) -> int:
    """How many child processes compile groups that are not cached yet; 0 if this process does it itself."""
    if num_groups < LEAST_GROUPS or usable_cores() < LEAST_CORES or folder_of("programs") is None:
        return 0
    number = min(compile_threads(), num_groups)
    for device in devices:
        stats = device.memory_stats() if device.platform != "cpu" else None
        if stats and stats.get("bytes_limit"):  # 0 with CUDA's own allocator, which takes what is needed
            fraction = float(os.environ.get("XLA_PYTHON_CLIENT_MEM_FRACTION") or _JAX_FRACTION)
            number = min(number, int(stats["bytes_limit"] * (1 / fraction - 1) / _BYTES_OF_CHILD))
    return max(number, 0) if number > 1 else 0


class CompileProcesses:
    """A number of child processes, which start at once; each compiles one group at a time."""

    def __init__(self, number: int):
        self._idle: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()
        self._begun: dict[str | None, Future[float]] = {}
        self._waiting = ThreadPoolExecutor(max(number, 1))  # a thread for each child that has begun
        platform = "cpu" if setting("jax_platforms") == "cpu" else "auto"
        command = [sys.executable, "-P", "-m", __name__, platform, str(folder_of(""))]
        path = [str(Path(bojax.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        changes = {
            "PYTHONPATH": os.pathsep.join(filter(None, path)),
            "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # this process has most of the memory
        }
        self._children: list[subprocess.Popen[bytes]] = []
        with contextlib.suppress(OSError):  # too little memory, or too many processes: fewer do as well
            for _ in range(number):
                child = subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=os.environ | changes,
                )
                self._children.append(child)
        flags = all_settings()  # which Python code may have set
        flags = {name: value for name, value in flags.items() if isinstance(value, bool | int | float | str)}
        for child in self._children:
            self._send(child, flags)
            self._idle.put(child)

    def begin(self, request: Request) -> bool:
        """Begin to compile programs in an idle process, for which `compile` then waits; False if none is."""
        try:
            child = self._idle.get_nowait()
        except queue.Empty:
            return False
        self._begun[request.key] = self._waiting.submit(self._compile_in, child, request)
        return True

    def compile(self, request: Request) -> float:
        """Compile programs in an idle process; returns the seconds that it took, 0 if none could do it."""
        if begun := self._begun.get(request.key):
            return begun.result()
        while True:
            try:
                return self._compile_in(self._idle.get_nowait(), request)
            except queue.Empty:  # more threads than processes, or the processes have ended
                begun = {each for each in self._begun.values() if not each.done()}
                if not begun:
                    return 0.0
                wait(begun, return_when=FIRST_COMPLETED)

    def _compile_in(self, child: subprocess.Popen[bytes], request: Request) -> float:
        """Compile programs in a process, which is idle afterwards; returns the seconds, 0 if it failed."""
        start = time.perf_counter()
        try:
            self._send(child, request)
            assert child.stdout is not None
            is_done = child.stdout.read(1) == _DONE
        except (OSError, ValueError, pickle.PicklingError):  # it has ended, or was closed
            return 0.0
        if child.poll() is None:
            self._idle.put(child)
        return time.perf_counter() - start if is_done else 0.0

    @staticmethod
    def _send(child: subprocess.Popen[bytes], message: Any) -> None:
        assert child.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended, which `compile` finds out
            pickle.dump(message, child.stdin)
            child.stdin.flush()

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._children)

    def close(self) -> None:
        """End the processes; what they compile is lost."""
        for child in self._children:
            child.kill()
        for child in self._children:
            child.wait()
            for pipe in (child.stdin, child.stdout):
                with contextlib.suppress(OSError):
                    assert pipe is not None
                    pipe.close()


class Ahead:
    """Child processes that compile the groups planned so far, once these are enough.

    To plan all sweeps of the thesis takes half a minute on slow cores, and keeps one of them busy. The others
    have compiled the first groups by then.
    """

    def __init__(self, devices: Sequence[Device]):
        self.processes = CompileProcesses(0)
        self._devices = devices
        self._new: deque[Request] = deque()
        self._offered: set[str | None] = set()

    def offer(self, plan: Plan) -> None:
        """Compile the groups of a sweep that is planned, as soon as a process is idle."""
        for task in longest_first([tasks_of(plan, plan.chunks, Storage())]):
            key = task.key(of_platform(self._devices, task.platform)[0])
            if key.is_new and key.name not in self._offered:
                self._offered.add(key.name)
                self._new.append(Request.of(key))
        if not self.processes and number_of_processes(len(self._new), self._devices):
            self.processes = CompileProcesses(number_of_processes(compile_threads(), self._devices))
            for device in self._devices:
                offer_shipped(device)
        while self._new and self.processes.begin(self._new[0]):
            self._new.popleft()

    def __enter__(self) -> "Ahead":
        return self

    def __exit__(self, *error: object) -> None:
        self.processes.close()


_DONE, _FAILED = b"1", b"0"


def _serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Compile what is requested until the parent ends; its first message are JAX's flags."""
    for name, value in pickle.load(requests).items():
        if getattr(jax.config, name, value) != value:
            jax.config.update(name, value)
    found = jax.devices()
    with contextlib.suppress(RuntimeError):  # JAX_PLATFORMS leaves it out
        found = [*found, *jax.devices("cpu")]
    devices = {(each.platform, each.local_hardware_id): each for each in found}
    choices: dict[Path, Choices] = {}
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        replies.write(_DONE if _is_compiled(request, devices, choices) else _FAILED)
        replies.flush()


def _is_compiled(
    request: Request, devices: Mapping[tuple[str, int], Device], choices: dict[Path, Choices]
) -> bool:
    """Compile programs; False if that is not possible, or if the parent would not find them."""
    try:
        device = devices[request.device]
        key = request.kind.key_of(request.group, device, request.num_lanes, request.recorded, request.wider)
        if key != request.key:
            return False
        of_plan = request.choices and choices.setdefault(request.choices, Choices(request.choices))
        made = request.kind(
            Functions(request.group),
            device,
            request.num_lanes,
            request.seed,
            recorded=request.recorded,
            wider=request.wider,
            choices=of_plan,
        )
        return made.is_saved
    except Exception:  # the parent meets the same error, and reports it
        return False


def _main(platform: str, cache: str) -> None:
    """A child process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends its children
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a program prints is no reply
    prepare("cpu" if platform == "cpu" else "auto")
    jax.config.update("jax_compilation_cache_dir", cache)
    _serve(sys.stdin.buffer, replies)


if __name__ == "__main__":
    _main(*sys.argv[1:])
