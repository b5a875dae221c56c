"""Compiled programs as files, which are loaded without being lowered again.

JAX finds a compiled program in its cache by what was lowered. To lower a traced program takes most of the
time of loading a group, and holds the interpreter, for which the threads that drive the devices wait.
The files here are found by the key of the group instead, see `program_cache`, and have the same machine code
as the entries of JAX's cache. Each device has its own: a compiled program names the device that it runs on.
Programs that came from JAX's cache, as after a change of code that does not change them, have none.
"""

import contextlib
import pickle
import zlib
from functools import partial

import jax
from jax.experimental import serialize_executable
from jax.stages import Compiled

from bojax.engine import program_cache
from bojax.engine.devices import Device
from bojax.engine.program import initialize_lapack
from bojax.engine.program_cache import Loaded
from bojax.numerics import disk_cache
from bojax.numerics.disk_cache import EXECUTABLES

_FAST = 1
"""Level of compression: higher ones take longer and save little."""


def save(key: str, device: Device, loaded: Loaded) -> None:
    """Save the compiled programs of a group for a device; nothing happens if that is not possible.

    All must have been compiled in this process: what XLA writes of a program for a CPU that it has read lacks
    functions, which is noticed only when the program is called.
    """
    with contextlib.suppress(Exception):  # of JAX: the next sweep lowers them again
        programs = {name: serialize_executable.serialize(made) for name, made in loaded.programs.items()}
        carry = [(leaf.shape, leaf.dtype) for leaf in loaded.carry]
        content = zlib.compress(pickle.dumps((programs, carry, dict(loaded.contents))), _FAST)
        disk_cache.write(f"{key}-{device.id}", content, EXECUTABLES)


def load(key: str | None, device: Device) -> Loaded | None:
    """The compiled programs of a group on a device; None if they are not saved, or cannot be loaded."""
    if key is None or not program_cache.is_saved(key):  # other devices need the traced programs
        return None
    content = disk_cache.read(f"{key}-{device.id}", EXECUTABLES)
    if content is None:
        return None
    if device.platform == "cpu":
        initialize_lapack()
    try:
        saved, carry, contents = pickle.loads(zlib.decompress(content))
        programs = {
            name: serialize_executable.deserialize_and_load(made, inputs, results, device.client, [device])
            for name, (made, inputs, results) in saved.items()
        }
    except Exception:  # of JAX, or of the format of another version
        return None
    if not all(_is_on(device, made) for made in programs.values()):
        return None
    program_cache.keep(key, list(programs))
    structure = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in carry]
    return Loaded(programs, partial(program_cache.load_program, key), structure, contents)


def _is_on(device: Device, made: Compiled) -> bool:
    """Whether a program runs on a device."""
    executable = made.runtime_executable()
    return executable is not None and executable.local_devices() == [device]
