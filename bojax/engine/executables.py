"""A cache of compiled programs that is looked up without tracing.

JAX's compilation cache saves the work of XLA, but a program must be traced before it can be looked up.
Tracing a group takes seconds, and holds the interpreter. The keys here are made of what a trace depends on
instead: the code, versions, flags, the kind of device, and the static content of the group. Only groups whose
classes and functions come from bojax and a few packages of known versions are cached: other code can change
unseen.
"""

import contextlib
import functools
import hashlib
import io
import os
import pickle
import platform
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.monitoring
import numpy as np
from jax.experimental import serialize_executable
from jax.stages import Compiled
from jaxtyping import PyTree
from typing_extensions import override

from bojax.engine.devices import Device, setting
from bojax.engine.groups import StaticGroup, nodes_with
from bojax.engine.provenance import code_hashes, installed

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
    "warp-lang",
)
"""Packages, with their versions in the key, whose classes and functions a cached group may contain."""

_MOST_HELD = 8
"""Number of groups whose programs stay in memory within `held`; the ones that were loaded last are kept."""

_DIGEST_BYTES = hashlib.sha256().digest_size
_KNOWN = {*sys.stdlib_module_names, *PACKAGES}
_UNUSED_SECONDS = 30 * 24 * 3600
"""Time after which an entry that was not used is deleted."""


def key_of(group: StaticGroup, device: Device, *details: object) -> str | None:
    """Name of the programs of a group on a device; None if they cannot be cached.

    Args:
        group: The group. The values of its arrays are inputs of the programs, and not part of the name.
        device: The device. All devices of its kind have the same programs.
        details: What else the programs depend on, such as the number of lanes.
    """
    kind = device.device_kind, device.client.platform_version
    parts = (_environment(), _flags(), jax.default_backend(), *kind)  # short loops depend on the backend
    return _digest_of(group, parts, details) if folder_of("programs") is not None else None


def tag_of(group: StaticGroup) -> str:
    """A short name of the content of a group, the same in every process.

    Programs of different groups get different names by it: JAX's cache then does not give a group a small
    program of another one, which could not be saved with the others.
    """
    return (_digest_of(group) or "")[:8]


def _digest_of(group: StaticGroup, *others: object) -> str | None:
    """Hash of the content of a group and of other values; None if something may change unseen."""
    if any(node.calls_process for node in nodes_with(group.static, "calls_process").values()):
        return None  # functions of this process cannot be saved
    content = jax.tree.map(_abstract, (group.swept, group.shared)), group.static
    try:
        with io.BytesIO() as file:
            _Pickler(file).dump((content, others))
            return hashlib.sha256(file.getvalue()).hexdigest()
    except Exception:  # foreign code, or something that cannot be pickled
        return None


Programs = tuple[dict[str, Compiled], PyTree[jax.ShapeDtypeStruct]]
"""The programs of a group, and the structure of its carry without shardings."""

_held: dict[tuple[str, Device], Programs] | None = None


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Context in which programs stay in memory, for sweeps of one process over the same groups."""
    global _held
    _held = {}
    try:
        yield
    finally:
        _held = None


def hold(key: str | None, device: Device, programs: Programs) -> None:
    """Keep programs in memory, within `held`."""
    held = _held
    if held is not None and key is not None:
        held[key, device] = programs
        while len(held) > _MOST_HELD:
            held.pop(next(iter(held)), None)


def load(key: str | None, device: Device) -> Programs | None:
    """The programs of a group held or saved under a key; None unless all of them are there and sound."""
    if key is None:
        return None
    if found := (_held or {}).get((key, device)):
        return found
    if (saved := _read(key)) is None:
        return None
    names, structure = saved
    programs = {name: program for name in names if (program := load_program(key, name, device)) is not None}
    return (programs, structure) if len(programs) == len(names) else None


def load_program(key: str | None, name: str, device: Device) -> Compiled | None:
    """The program of this name that is saved under the key of its group; None if there is none."""
    saved = None if key is None else _read(f"{key}-{name}")
    try:
        return None if saved is None else _loaded(saved, device)
    except Exception:  # refused by XLA
        return None


def is_saved(key: str | None) -> bool:
    """Whether all programs of a group are saved under a key."""
    folder = folder_of("programs")
    return key is not None and folder is not None and (folder / key).exists()


def save_program(key: str, name: str, program: Compiled) -> bool:
    """Save a program under the key of its group; False if that is not possible."""
    return _write(f"{key}-{name}", lambda: _serialized(program))


def save(key: str, names: Collection[str], structure: PyTree[jax.ShapeDtypeStruct]) -> bool:
    """Save that the programs of a group are these, all saved, and the structure of its carry.

    Until then, as after a kill between two programs, those that are saved are loaded one by one.
    """
    folder = folder_of("programs")
    if folder is None or not _write(key, lambda: (tuple(names), structure)):
        return False
    with contextlib.suppress(OSError):  # another process may delete them, too
        drop_unused(folder)
    return True


def _write(name: str, content_of: Callable[[], object]) -> bool:
    """Write an entry with its checksum, whole or not at all; False if that is not possible."""
    folder = folder_of("programs")
    if folder is None:
        return False
    try:
        content = pickle.dumps(content_of())
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            try:
                file.write(hashlib.sha256(content).digest() + content)
                file.flush()
            except OSError:  # a full disk must not be filled further
                os.unlink(file.name)
                raise
        os.replace(file.name, folder / name)
    except Exception:  # a program with callbacks, a full disk: the next sweep compiles again
        return False
    return True


def _read(name: str) -> Any:
    """The content of an entry; None if it is missing or damaged."""
    folder = folder_of("programs")
    if folder is None:
        return None
    try:
        content = (folder / name).read_bytes()
        digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != digest:
            return None
        os.utime(folder / name)
        return pickle.loads(content)
    except Exception:  # of the disk, or of a class that is no longer there
        return None


def _serialized(program: Compiled) -> tuple[bytes, PyTree, PyTree]:
    """A program, and trees of the structures of its inputs and outputs.

    Trees stand for structures: those of Equinox modules hold sentinels, which would lose their identity.
    """
    content, inputs, outputs = serialize_executable.serialize(program)
    return content, _tree(inputs), _tree(outputs)


def _tree(structure: Any) -> PyTree:
    return jax.tree.unflatten(structure, range(structure.num_leaves))


def _loaded(saved: tuple[bytes, PyTree, PyTree], device: Device) -> Compiled:
    """As `serialize_executable.deserialize_and_load`, but for any device of the kind."""
    content, inputs, outputs = saved
    if device.platform == "cpu":
        _initialize_lapack()
    unloaded, arguments, no_kwargs = _Unpickler(content, device).load()
    described = jax.tree.unflatten(jax.tree.structure(inputs), arguments)
    return Compiled(unloaded.load(), [], described, jax.tree.structure(outputs), no_kwargs=no_kwargs)


@functools.cache
def _initialize_lapack() -> None:
    """Look up the functions of LAPACK, as lowering does: a loaded program would call a null pointer."""
    matrix = jax.ShapeDtypeStruct((1, 1), np.float32)
    jax.jit(jax.numpy.linalg.cholesky).trace(matrix).lower(lowering_platforms=("cpu",))


class _Unpickler(pickle.Unpickler):
    """Replaces the device that a program was compiled for by the one that it is loaded for.

    The marks that it reads are those of `serialize_executable.serialize`.
    """

    def __init__(self, content: bytes, device: Device):
        super().__init__(io.BytesIO(content))
        self._device = device

    @override
    def persistent_load(self, pid: Any) -> Any:
        kind, *content = pid
        if kind == "device":
            return self._device
        if kind == "client":
            return self._device.client
        # Imported here, since it may move: then nothing is loaded, and programs are compiled.
        from jax._src.lib import xla_client  # pyright: ignore[reportPrivateImportUsage]

        options = xla_client.CompileOptions()
        options.device_assignment = xla_client.DeviceAssignment.create(np.asarray([[self._device.id]]))
        devices = xla_client.DeviceList((self._device,))
        return self._device.client.deserialize_executable(*content, devices, options)


def drop_damaged(tag: str) -> None:
    """Delete the entries of a group in JAX's cache if one of them is damaged; once in a process.

    JAX writes an entry in place and never replaces it. One that a full disk or a kill has cut short would
    cost a warning and a compilation in every later sweep. The other entries go too, so that all programs
    of the group are compiled anew and can be saved together.

    Args:
        tag: The `tag_of` the group.
    """
    folder = folder_of("")
    if folder is None or (folder, tag) in checked:
        return
    checked.add((folder, tag))
    try:
        # Imported here, since it may move: then nothing is checked.
        from jax._src.compilation_cache import (  # pyright: ignore[reportPrivateImportUsage]
            decompress_executable,
        )

        entries = list(folder.glob(f"jit_*_{tag}-*-cache"))
        try:
            for entry in entries:
                decompress_executable(entry.read_bytes())
        except Exception:  # of the library that compresses
            for entry in entries:
                entry.unlink(missing_ok=True)
    except (ImportError, OSError):
        return


checked: set[tuple[Path, str]] = set()
"""Folders and tags that `drop_damaged` has seen in this process."""


@contextlib.contextmanager
def compiled_anew() -> Iterator[list[str]]:
    """An entry for each program that XLA compiles in this thread within the context.

    Others come from JAX's cache, and XLA cannot serialise them again: on a CPU they lose their kernels.
    """
    _misses.found = []
    yield _misses.found
    _misses.found = None


def _note(event: str, **_: object) -> None:
    if event == "/jax/compilation_cache/cache_misses" and getattr(_misses, "found", None) is not None:
        _misses.found.append(event)


_misses = threading.local()
jax.monitoring.register_event_listener(_note)


def drop_unused(folder: Path) -> None:
    """Delete the entries that were not used for a month."""
    oldest = time.time() - _UNUSED_SECONDS
    for path in folder.iterdir():
        if path.stat().st_mtime < oldest:
            path.unlink()


def folder_of(what: str) -> Path | None:
    """A folder of the cache, in that of JAX's; None if there is none on a local disk."""
    folder = setting("jax_compilation_cache_dir")
    if folder is None or "://" in folder or not setting("jax_enable_compilation_cache"):
        return None
    return Path(folder) / what


def _abstract(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


@functools.cache
def _environment() -> str:
    """Code, versions, and processor, which do not change while the process runs."""
    parts = [
        code_hashes(()),
        installed(PACKAGES),
        sys.version,
        platform.machine(),
        os.environ.get("XLA_FLAGS"),
    ]
    cpus = Path("/proc/cpuinfo")
    if cpus.exists():
        parts.append(sorted({line for line in cpus.read_text().splitlines() if line.startswith("flags")}))
    return repr(parts)


def _flags() -> str:
    """JAX's flags, without the place of the cache."""
    names = sorted(name for name in jax.config.values if "cache_dir" not in name)
    return repr([(name, str(getattr(jax.config, name, None))) for name in names])


class _Pickler(pickle.Pickler):
    """Refuses classes and functions of unknown code."""

    @override
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type) or callable(obj):
            module = getattr(obj, "__module__", None) or ""
            if module.partition(".")[0] not in _KNOWN:
                raise pickle.PicklingError(f"{obj!r} is not part of a known package")
        return NotImplemented
