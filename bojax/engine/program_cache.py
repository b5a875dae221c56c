"""A cache of traced programs, in front of JAX's cache of compiled ones.

JAX's compilation cache saves the work of XLA, but a program must be traced before it can be looked up.
Tracing a group takes seconds, and holds the interpreter. Here, traced programs are kept as `jax.export`
serialises them. Their keys are made of what a trace depends on: the code, versions, flags, the kind of
device, and the static content of the group. Only groups whose classes and functions come from bojax and a
few packages of known versions are cached: other code can change unseen.

Reading an entry runs no code: it is StableHLO, which JAX lowers and looks up in its own cache. The entries of
JAX's cache, and those of `executables`, are machine code, which XLA runs. `devices.prepare` therefore uses a
folder only if it belongs to the user and nobody else can write to it.
"""

import contextlib
import functools
import hashlib
import io
import json
import os
import pickle
import platform
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.monitoring
from jax.stages import Compiled
from typing_extensions import override

from bojax.engine.devices import Device, all_settings
from bojax.engine.groups import StaticGroup, nodes_with
from bojax.engine.program import Program, abstract
from bojax.engine.provenance import code_hashes, installed
from bojax.numerics.disk_cache import PROGRAMS, content_of, drop_unused, folder_of, read, write

PACKAGES = (
    "bojax",
    "equinox",
    "jax",
    "jaxlib",
    "jaxtyping",
    "mujoco",
    "mujoco-mjx",
    "numpy",
    "optax",
    "scipy",
)
"""Packages, with their versions in the key, whose classes and functions a cached group may contain."""

_MOST_HELD = 16
"""Number of groups, counted for each device, whose programs `held` keeps in memory: those loaded last."""

_TAG_DIGITS = 16
"""Number of digits of a key that stand for the content of the group, whatever the version of the code."""

_KNOWN = {*sys.stdlib_module_names, *PACKAGES}


def key_of(group: StaticGroup, device: Device, *details: object) -> str | None:
    """Name of the programs of a group on a device; None if they cannot be cached.

    The values of the arrays of the group are inputs of the programs, and not part of the name. All devices of
    a kind have the same programs. `details` are what else they depend on, such as the number of lanes.
    """
    content = _digest_of(group, *details)
    if content is None or folder_of(PROGRAMS) is None:
        return None
    kind = device.device_kind, device.client.platform_version
    flags = repr(sorted((name, str(value)) for name, value in all_settings().items()))
    parts = (_environment(), flags, jax.default_backend(), *kind)  # short loops depend on the backend
    return content[:_TAG_DIGITS] + hashlib.sha256(repr(parts).encode()).hexdigest()[:48]


def _digest_of(group: StaticGroup, *others: object) -> str | None:
    """Hash of the content of a group and of other values; None if something may change unseen."""
    if any(node.calls_process for node in nodes_with(group.static, "calls_process").values()):
        return None  # functions of this process cannot be saved
    content = jax.tree.map(abstract, (group.swept, group.shared)), group.static
    try:
        with io.BytesIO() as file:
            pickler = _Pickler(file)
            pickler.fast = (
                True  # without references: equal contents have equal bytes, however they came about
            )
            pickler.dump((content, others))
            return hashlib.sha256(file.getvalue()).hexdigest()
    except Exception:  # foreign code, or something that cannot be pickled
        return None


_held: dict[tuple[str, Device], "Loaded"] | None = None


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Keep programs in memory while this context is open, for sweeps of one process over the same groups."""
    global _held
    _held = {}
    try:
        yield
    finally:
        _held = None


def hold(key: str | None, device: Device, programs: "Loaded") -> None:
    """Keep programs in memory, within `held`."""
    held = _held
    if held is not None and key is not None:
        held[key, device] = programs
        while len(held) > _MOST_HELD:
            held.pop(next(iter(held)), None)


def held_programs(key: str | None, device: Device) -> "Loaded | None":
    """The programs that `hold` keeps under a key; None if there are none."""
    return None if key is None else (_held or {}).get((key, device))


class Loaded(NamedTuple):
    """The programs of a group on a device."""

    programs: Mapping[str, Compiled]  # the compiled programs, functions of the leaves of their inputs
    # The same program before its compilation, by its name; None if it is not saved
    traced: "Callable[[str], Program | None]"
    carry: Sequence[jax.ShapeDtypeStruct]  # shapes and dtypes of the leaves of the carry
    # Hashes of what XLA has made of the programs, see `autotuning.contents_of`
    contents: Mapping[str, str] = MappingProxyType({})


Traced = tuple[Mapping[str, Program], Sequence[jax.ShapeDtypeStruct]]
"""The programs of a group, and the leaves of its carry, which are the first inputs of the first program."""


def save(key: str, names: Collection[str], num_carried: int) -> bool:
    """Save that the programs of a group are these, all saved, and the number of leaves of its carry.

    Until then, as after a kill between two programs, those that are saved are loaded one by one.
    """
    if not write(key, json.dumps([list(names), num_carried]).encode()):
        return False
    drop_unused()
    return True


def load(key: str | None) -> Traced | None:
    """The programs of a group saved under a key, and the leaves of their carry; None unless all are there."""
    content = None if key is None else read(key)
    if content is None:
        return None
    try:
        names, num_carried = json.loads(content)
        programs = {name: program for name in names if (program := load_program(key, name)) is not None}
        return (programs, programs[names[0]].inputs[:num_carried]) if len(programs) == len(names) else None
    except Exception:  # of the format of another version
        return None


def is_saved(key: str | None) -> bool:
    """Whether all programs of a group are saved under a key."""
    folder = folder_of(PROGRAMS)
    return key is not None and folder is not None and (folder / key).exists()


def keep(key: str, names: Collection[str]) -> None:
    """Mark the saved programs of a group as used."""
    if (folder := folder_of(PROGRAMS)) is not None:
        for name in (key, *(f"{key}-{name}" for name in names)):
            with contextlib.suppress(OSError):  # it is missing, or the file system is mounted for reading
                os.utime(folder / name)


def save_program(key: str, name: str, program: Program) -> bool:
    """Save an exported program under the key of its group; False if that is not possible."""
    if program.exported is None:
        return False
    try:
        return write(f"{key}-{name}", program.serialized())
    except Exception:  # of the exporter: the next sweep traces again
        return False


def load_program(key: str | None, name: str) -> Program | None:
    """The program of this name that is saved under the key of its group; None if it is not saved."""
    content = None if key is None else read(f"{key}-{name}")
    if content is None:
        return None
    try:
        return Program.deserialized(content)
    except Exception:  # of the format of another version
        return None


def compiled(key: str | None, name: str, program: Program, device: Device) -> tuple[Compiled, Set[str]]:
    """A compiled program, and the events of JAX's cache: `FOUND`, and `WRITTEN` if anything was compiled.

    JAX writes its entries in place, without a hash, and never replaces one: what a full disk or a kill has
    cut short would be compiled again in every later sweep, with a warning. The hashes of the entries are kept
    here, and entries that do not have theirs are deleted.
    """
    # The tag has no version in it: a change of code that leaves the program as it is still finds the entry.
    own = f"{name}_{key[:_TAG_DIGITS]}" if key else name
    kept = set[Path]()
    for path in _entries_of(own) if key else ():
        content = _hash_of(path)
        if content is not None and read(path.name) == content:
            kept.add(path)
        else:
            with contextlib.suppress(OSError):  # a folder, or one that is mounted for reading
                path.unlink()
    with _noting() as events:
        made = program.compile(own, device)
    if key and WRITTEN in events:
        # Only what this compilation has added is trusted: others may write under the same name.
        for path in set(_entries_of(own)) - kept:
            write(path.name, _hash_of(path) or b"")
    return made, events


def _entries_of(name: str) -> list[Path]:
    """The entries of JAX's cache of programs that were compiled under a name."""
    folder = folder_of("")
    return [] if folder is None else list(folder.glob(f"jit_{name}-*-cache"))


def _hash_of(path: Path) -> bytes | None:
    """The hash of a file; None if it is missing or not a regular file."""
    with contextlib.suppress(OSError):
        return hashlib.sha256(content_of(path)).digest()
    return None


FOUND, WRITTEN = "/jax/compilation_cache/cache_hits", "/jax/compilation_cache/cache_misses"
"""Events of JAX when its cache gives a program, and when it takes one that was compiled."""


@contextlib.contextmanager
def _noting() -> Iterator[set[str]]:
    """The events of JAX's cache in this thread within the context."""
    _events.noted = noted = set[str]()
    try:
        yield noted
    finally:
        _events.noted = None


def _note(event: str, **_: object) -> None:
    if (noted := getattr(_events, "noted", None)) is not None:
        noted.add(event)


_events = threading.local()
jax.monitoring.register_event_listener(_note)


@functools.cache
def _environment() -> str:
    """Code, versions, and processor, which do not change while the process runs."""
    parts = [
        code_hashes(()),
        installed(PACKAGES),
        sys.version,
        platform.machine(),
        os.environ.get("XLA_FLAGS") or None,
    ]
    cpus = Path("/proc/cpuinfo")
    if cpus.exists():
        parts.append(sorted({line for line in cpus.read_text().splitlines() if line.startswith("flags")}))
    return repr(parts)


class _Pickler(pickle.Pickler):
    """Refuses classes and functions of unknown code."""

    @override
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type) or callable(obj):
            module = getattr(obj, "__module__", None) or ""
            if module.partition(".")[0] not in _KNOWN:
                raise pickle.PicklingError(f"{obj!r} is not part of a known package")
        return NotImplemented
