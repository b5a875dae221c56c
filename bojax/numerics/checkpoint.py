"""Checkpoints: trees of arrays saved by Orbax, restored to a given structure and given devices.

A checkpoint is a folder that Orbax opens as a dictionary of arrays, named after their place in the tree, such
as `model/weights`; typed keys are their key data. Orbax detects no damage: whoever keeps a checkpoint also
keeps the checksums of its files.
"""

import contextlib
import errno
import functools
import logging
import os
import re
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from bojax.numerics.simulation_keys import is_key
from bojax.results.store import ResultsError, explained
from bojax.text import error_line

_USING = threading.Lock()
"""Held while a save begins, and during a load: Orbax counts its operations without a lock."""


def arrays(tree: PyTree[Array]) -> dict[str, Array]:
    """The arrays of a tree by name, without those that have no elements, which Orbax refuses."""
    return {name: _plain(leaf) for name, leaf in _named(tree) if leaf.size}


def save(folder: Path, content: Mapping[str, Any]) -> Callable[[], None]:
    """Copy arrays to the host, and begin to write them to a folder, which appears once it is complete.

    The arrays may be given away as soon as this returns.

    Args:
        folder: The folder, which must not exist.
        content: The arrays, also in nested dictionaries.

    Returns:
        A function that waits for the end; it raises a `ResultsError` as `save` does.

    Raises:
        ResultsError: The folder cannot be written; nothing of it is left.
    """
    with _USING, _written(folder), _context() as orbax:
        path, unpin = _pinned(folder)
        end = orbax.save_async(path, dict(content))

    def wait() -> None:
        with _written(folder):  # without `_USING`: others may begin a save while this one ends
            end.result()
            unpin()  # not after an error, when a thread of Orbax may still write there

    return wait


def read(folder: Path) -> dict[str, Any]:
    """The content of a folder whose arrays were saved as NumPy arrays, as such."""
    with _readable(folder, f"delete {folder}"), _USING, _context() as orbax:
        return orbax.load(folder.absolute())


def restore(
    folder: Path, structure: PyTree[jax.ShapeDtypeStruct], advice: str | None = None
) -> PyTree[Array]:
    """Read a tree of the given structure; a leaf without a sharding is placed on the first device.

    Args:
        folder: Folder to which the `arrays` of a tree were saved.
        structure: Shapes, dtypes and shardings of the leaves.
        advice: Advice that ends the error message; by default, how to resume without this checkpoint.

    Raises:
        ResultsError: The folder is missing, damaged, or holds a tree of another structure.
    """
    advice = advice or f"delete the folder {folder.parent} and resume to compute this chunk again"
    with _readable(folder, advice), _USING, _context() as orbax:
        found = orbax.metadata(folder.absolute()).metadata
        targets = _compared(found, structure)  # Orbax casts another dtype in silence
        return _rebuilt(orbax.load(folder.absolute(), targets), structure)


def fit(
    found: Mapping[str, np.ndarray], structure: PyTree[jax.ShapeDtypeStruct], origin: Path, advice: str
) -> PyTree[Array]:
    """Rebuild a tree from what `arrays` has returned, as `restore` does from a folder.

    Raises:
        ResultsError: They are those of another structure.
    """
    with _readable(origin, advice):
        _compared(found, structure)
        return _rebuilt(found, structure)


def _compared(
    found: Mapping[str, Any], structure: PyTree[jax.ShapeDtypeStruct]
) -> dict[str, jax.ShapeDtypeStruct]:
    """What Orbax shall load, after a comparison of names, shapes and dtypes."""
    targets = {name: _target(leaf) for name, leaf in _named(structure) if leaf.size}
    if set(found) != set(targets):
        raise ValueError("its arrays are not those of this program")
    for name, target in targets.items():
        for what in ("shape", "dtype"):
            is_there, wanted = getattr(found[name], what), getattr(target, what)
            if is_there != wanted:
                raise ValueError(f"{name} has {what} {is_there}, not {wanted}")
    return targets


def _rebuilt(found: Mapping[str, Any], structure: PyTree[jax.ShapeDtypeStruct]) -> PyTree[Array]:
    def leaf_of(name: str, leaf: jax.ShapeDtypeStruct) -> Array:
        target = _target(leaf)
        values = found[name] if leaf.size else jnp.empty(target.shape, target.dtype)
        array = jax.device_put(values, target.sharding)
        return jax.random.wrap_key_data(array, impl=_key_impl(leaf)) if is_key(leaf) else array

    leaves = [leaf_of(name, leaf) for name, leaf in _named(structure)]
    return jax.tree.unflatten(jax.tree.structure(structure), leaves)


def _target(leaf: jax.ShapeDtypeStruct) -> jax.ShapeDtypeStruct:
    plain = jax.eval_shape(_plain, leaf)
    sharding = leaf.sharding or jax.sharding.SingleDeviceSharding(jax.devices()[0])
    return jax.ShapeDtypeStruct(plain.shape, plain.dtype, sharding=sharding)


def _named(tree: PyTree) -> list[tuple[str, Any]]:
    return [
        (jax.tree_util.keystr(path, simple=True, separator="/") or "array", leaf)
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    ]


def _plain(leaf):
    return jax.random.key_data(leaf) if is_key(leaf) else leaf


def _key_impl(target: jax.ShapeDtypeStruct) -> str:
    return str(jax.random.key_impl(jnp.empty(0, target.dtype)))


# Orbax: how it is called, and what it says.


@contextlib.contextmanager
def _context() -> Iterator[Any]:
    orbax = _orbax()
    context = orbax.Context()
    context.array.saving.use_compression = False  # ZSTD on one core takes far longer than the disk
    context.asynchronous.create_directories_asynchronously = False  # fails if several threads save
    with context:
        yield orbax


@functools.cache
def _orbax() -> Any:
    """The module, imported when the first checkpoint is written or read: a short sweep has none."""
    handlers = list(logging.root.handlers)
    from orbax.checkpoint import v1

    logging.root.handlers[:] = handlers  # its logger adds one, which would repeat messages of others
    # A full disk is one error here, and hundreds of lines of Orbax's threads.
    for name in ("absl", "asyncio"):
        logging.getLogger(name).addFilter(_is_of_others)
    others = sys.unraisablehook
    sys.unraisablehook = lambda one: None if str(one.exc_value) == "Event loop is closed" else others(one)
    return v1


def _is_of_others(record: logging.LogRecord) -> bool:
    stack = logging.Formatter().formatException(record.exc_info) if record.exc_info else ""
    return "orbax" not in f"{record.pathname} {record.getMessage()} {stack}"


def _pinned(folder: Path) -> tuple[Path, Callable[[], None]]:
    """A path to a new folder that is gone once the folder above is deleted, and what ends its use.

    Orbax makes missing folders above its own, at any time of a save. After the end of a sweep, one of its
    workers that is late would make the working folder again, and the sweep would seem to be unfinished.
    """
    if not os.path.isdir("/proc/self/fd"):  # only Linux has such paths
        return folder.absolute(), lambda: None
    descriptor = os.open(folder.parent, os.O_RDONLY | os.O_DIRECTORY)
    return Path(f"/proc/self/fd/{descriptor}", folder.name), lambda: os.close(descriptor)


@contextlib.contextmanager
def _written(folder: Path) -> Iterator[None]:
    """Turn an error of a save into a `ResultsError`, and delete what there is of the folder."""
    try:
        yield
    except Exception as error:  # TensorStore raises ValueError for errors of the file system
        # Orbax writes to a folder of this name, which it renames at the end.
        for path in folder.parent.glob(f"{folder.name}.orbax-checkpoint-tmp*"):
            shutil.rmtree(path, ignore_errors=True)
        found = re.search(r"os_error_code='(\d+)'", str(error))
        number = int(found[1]) if found else getattr(error, "errno", None) or errno.EIO
        with explained(folder):
            raise OSError(number, error_line(error)) from error


@contextlib.contextmanager
def _readable(folder: Path, advice: str) -> Iterator[None]:
    """Turn an error of a load into a `ResultsError`; a damaged checkpoint raises many types of exceptions."""
    try:
        yield
    except Exception as error:
        reason = f"the checkpoint cannot be read ({error_line(error)})"
        raise ResultsError(f"{folder}: {reason}: {advice}") from error
