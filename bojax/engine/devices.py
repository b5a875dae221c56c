"""Devices: their selection, their workers, and JAX's process-wide flags.

`prepare` sets the flags and must be called before JAX starts a backend.
"""

import atexit
import os
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar, runtime_checkable

import jax

from bojax.config.errors import note_once
from bojax.config.settings import Platform
from bojax.engine.errors import EngineError
from bojax.numerics.cores import usable_cores
from bojax.text import error_line

_OF_DRAWS: Mapping[str, object] = {
    "jax_default_prng_impl": "threefry2x32",
    "jax_threefry_partitionable": True,
    "jax_random_seed_offset": 0,
}
"""Flags on which the random numbers of a seed depend."""

_FIXED: Mapping[str, object] = {"jax_enable_x64": True, **_OF_DRAWS}
"""Flags on which the numbers of a run depend, which must follow from its plan alone."""

_FLAGS = (*_FIXED, "jax_platforms", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
"""Flags that `prepare` sets."""

_REQUIRED: Mapping[str, tuple[object, ...]] = {
    "jax_disable_jit": (False,),
    "jax_transfer_guard": (None, "allow", "log", "log_explicit"),
}
"""Values of flags with which the engine, which calls compiled programs, can run."""

Device: TypeAlias = Any
"""A JAX device; `Any`, since type checkers take `jax.Device` for a variable."""


def prepare(device: Platform) -> None:
    """Set JAX's process-wide flags: platform, float64, random numbers, persistent compilation cache.

    A platform or a cache that the user has set, in the environment or in JAX's configuration, is left alone.

    Raises:
        EngineError: The user has set a flag with which no program runs.
    """
    _check_flags()
    for flag, value in _FIXED.items():
        jax.config.update(flag, value)
    if device == "cpu" and not setting("jax_platforms"):
        _update_before_start("jax_platforms", "cpu")
    if setting("jax_compilation_cache_dir") is None:
        folder = cache_folder()
        if reason := why_not_private(folder):
            note_once(f"note: programs are not cached in {folder}: {reason}")
        else:
            _drop_irregular(folder)
            jax.config.update("jax_compilation_cache_dir", str(folder))
    if setting("jax_persistent_cache_min_compile_time_secs") == _LEAST_SECONDS:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _drop_irregular(folder: Path) -> None:
    """Delete entries of JAX's cache that are no regular files: JAX would wait for a pipe for ever."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            is_odd = not entry.is_file(follow_symlinks=False) and not entry.is_dir(follow_symlinks=False)
            if is_odd and entry.name.endswith("-cache"):
                Path(entry.path).unlink(missing_ok=True)


_LEAST_SECONDS = 1.0
"""JAX's default time of a compilation that it caches; a sweep has many smaller programs."""


def _check_flags() -> None:
    for flag, values in _REQUIRED.items():
        if (given := setting(flag)) not in values:
            allowed = ", ".join(str(value) for value in values if value is not None)
            raise EngineError(f"{flag.upper()}: got {given}; allowed: {allowed}")


_started: Future[None] | None = None


def start_early(device: Platform) -> None:
    """Start JAX's backends in a thread: CUDA takes a second, enough to import other packages.

    At exit, the process waits for the thread: unloading CUDA while it starts would abort the process.
    """
    global _started
    prepare(device)
    if _started is not None:
        return
    _started = started = Future()

    def start() -> None:
        try:
            jax.devices()
            started.set_result(None)
        except BaseException as error:  # raised again by `find_devices`
            started.set_exception(error)

    thread = threading.Thread(target=start, daemon=True)
    thread.start()
    atexit.register(thread.join)


@contextmanager
def restored() -> Iterator[None]:
    """Context after which JAX's flags and the search path of modules are as before."""
    flags = {name: setting(name) for name in _FLAGS}
    path = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = path
        for name, value in flags.items():
            _update_before_start(name, value)


@contextmanager
def same_draws() -> Iterator[None]:
    """Context in which a seed gives the random numbers of a sweep, whatever flags the caller has set."""
    others = {name: given for name, value in _OF_DRAWS.items() if (given := setting(name)) != value}
    try:
        for name in others:
            jax.config.update(name, _OF_DRAWS[name])
        yield
    finally:
        for name, value in others.items():
            jax.config.update(name, value)


def find_devices(device: Platform) -> list[Device]:
    """The devices of the requested platform; `auto` means all GPUs and, last, the CPU.

    Raises:
        EngineError: There is no device of this platform, or a flag is set with which no program runs.
    """
    _check_flags()
    try:
        if _started is not None:
            _started.result()  # JAX raises the error of a backend only once, and then goes on without it
        else:
            jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter for JAX_PLATFORMS=cuda without such a device
        raise EngineError(_failure(error)) from None
    try:
        found = jax.devices(None if device == "auto" else device)
    except RuntimeError:
        advice = "use engine.device=auto, or run `bojax doctor`"
        only = jax.default_backend()
        raise EngineError(f"engine.device: got {device}; JAX finds only {only} devices: {advice}") from None
    if found[0].platform == "cpu":
        return found
    cpu = _cpu() if device == "auto" else None
    return found if cpu is None else [*found, cpu]


def _failure(error: Exception) -> str:
    """Why JAX has not started, and what to do."""
    reason = f": {error_line(error)}" if str(error) else ""
    if given := setting("jax_platforms"):
        allowed = "platforms that JAX can start on this machine, or unset it"
        return f"JAX_PLATFORMS: got {given}; allowed: {allowed}{reason}"
    return f"JAX cannot start; run `bojax doctor`, or use engine.device=cpu{reason}"


@runtime_checkable
class _Placed(Protocol):
    @property
    def platform(self) -> str: ...


P = TypeVar("P", bound=_Placed)


def of_platform(found: Iterable[P], platform: str) -> list[P]:
    """Those devices, or tasks and groups, whose platform is the given one."""
    return [each for each in found if each.platform == platform]


def suited(devices: Sequence[Device]) -> list[Device]:
    """The devices on which a sweep runs: the GPUs of this process, or else the CPU."""
    return of_platform(devices, devices[0].platform)


def choose(devices: Sequence[Device], indices: Sequence[int] | None) -> list[Device]:
    """The devices of the given indices, and the CPU beside GPUs.

    If `indices` is None, these are all GPUs, or the first of the devices into which XLA's flags divide a CPU.

    Raises:
        EngineError: There is no device of an index.
    """
    counted = of_platform(devices, devices[0].platform)
    for index in indices or ():
        if index >= len(counted):
            found = f"{len(counted)} x {counted[0].platform} ({counted[0].device_kind})"
            raise EngineError(
                f"--devices: got {index}; allowed: 0 to {len(counted) - 1}, this machine has {found}"
            )
    others = [device for device in devices if device not in counted]
    if indices is None:
        indices = range(1 if counted[0].platform == "cpu" else len(counted))
    return [*(counted[index] for index in indices), *others]


def workers_of(devices: Sequence[Device], cores: int | None = None) -> list[Device]:
    """The device of each worker: two workers for each accelerator, and one for each core of a CPU.

    Beside accelerators, the CPU has one worker for four cores: half of the cores compile, and the threads
    that drive the accelerators must not wait. (With one for two, EMU-Q on cartpole advanced for 137 s on an
    H200 with 16 cores; for 60 s on one with 32 cores and no such workers.)

    XLA runs a vmapped loop on the core of the thread that called the program. Workers of a CPU, by default
    for all cores of this process, share the one device, and with it the compiled programs. Those of an
    accelerator share a lock, see `new_lock`.
    """
    cpus = of_platform(devices, "cpu")
    workers = [device for device in devices if device not in cpus for _ in range(2)]
    if len(cpus) == 1:
        cores = cores or usable_cores()
        cpus *= max(1, cores // 4) if workers else cores
    return workers + cpus


def new_lock(device: Device) -> AbstractContextManager[Any]:
    """What a worker holds while it uses a device.

    A device of an accelerator runs one chunk at a time, since JAX runs the programs of a device one after
    another. A GPU that runs several has several clients, each a device of its own (`gpu_clients`). While one
    worker writes the last rows of a chunk, or waits for a program, the other one uses the device. Workers of
    a CPU hold nothing: each uses a core.
    """
    return nullcontext() if device.platform == "cpu" else threading.Lock()


@contextmanager
def released(lock: AbstractContextManager[Any]) -> Iterator[None]:
    """Let another worker use the device meanwhile; called by the worker that holds the lock."""
    lock.__exit__(None, None, None)
    try:
        yield
    finally:
        lock.__enter__()


@contextmanager
def on_cpu() -> Iterator[None]:
    """Let JAX compute on the CPU, if it has started there, while this context is open.

    For many small operations one after the other: a GPU would compile and launch each of them.
    """
    device = _cpu()
    with nullcontext() if device is None else jax.default_device(device):
        yield


def _cpu() -> Device | None:
    """The CPU; None if `JAX_PLATFORMS` leaves it out."""
    try:
        return jax.devices("cpu")[0]
    except RuntimeError:
        return None


def cache_folder() -> Path:
    """Folder of the persistent compilation cache: `BOJAX_CACHE`, or else in the user's cache folder."""
    if given := os.environ.get("BOJAX_CACHE"):
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "bojax" / "jax"


def why_not_private(folder: Path) -> str | None:
    """Why a folder of compiled programs is not used; None for one that is. A missing folder is created.

    Whoever can write to the folder can run code as the user: its entries are machine code.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        return error_line(error)
    if found.st_uid != os.geteuid():
        return "it belongs to another user"
    return "others can write to it" if found.st_mode & 0o022 else None


def setting(flag: str) -> Any:
    """The value of one of JAX's flags."""
    return getattr(jax.config, flag)


def all_settings() -> dict[str, Any]:
    """The values of JAX's flags, without the place of the cache."""
    return {name: getattr(jax.config, name, None) for name in jax.config.values if "cache_dir" not in name}


def _update_before_start(flag: str, value: object) -> None:
    """Set a flag that JAX refuses to change once a backend has started; in that case it stays as it is."""
    with suppress(RuntimeError):
        jax.config.update(flag, value)
