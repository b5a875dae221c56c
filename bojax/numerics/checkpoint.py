"""Checkpoints: trees of arrays saved with Orbax and restored to a given structure and shardings.

Typed keys are saved as their key data.
"""

import logging
import threading
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from bojax.logs import quiet
from bojax.results.store import ResultsError, fingerprint, read_checked_json, write_checked_json
from bojax.text import error_line

_ONE_AT_A_TIME = threading.Lock()
"""Orbax runs an event loop, which threads cannot share; nor can they share the level of its log."""

_CHECKSUM = "checksum.json"
"""File with the size and SHA-256 of every other file of the checkpoint; Orbax does not detect all damage."""


def save(path: Path, tree: PyTree[Array]) -> None:
    """Write a tree and its checksums; Orbax renames the folder into place once it is complete.

    Raises:
        ResultsError: The tree cannot be written.
    """
    ocp = _orbax()
    # Orbax refuses empty arrays; `restore` creates them from their shape.
    leaves = {_name(i): _plain(leaf) for i, leaf in enumerate(jax.tree.leaves(tree)) if leaf.size}
    try:
        with _ONE_AT_A_TIME, _quiet():
            ocp.save(str(path.resolve()), leaves, overwrite=True)
        write_checked_json(path / _CHECKSUM, {"files": fingerprint(path)})
    except ResultsError:
        raise
    except Exception as error:
        # Tasks of Orbax may fail, and be logged with a traceback, after the call has raised.
        for name in ("absl", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        if "No space left" in str(error) or getattr(error, "errno", None) == 28:
            raise ResultsError(
                f"{path}: the disk is full; free some space, then run again with --resume", exit_code=1
            ) from error
        raise ResultsError(f"{path}: the checkpoint cannot be written ({error_line(error)})", 1) from error


def restore(path: Path, structure: PyTree[jax.ShapeDtypeStruct], advice: str | None = None) -> PyTree[Array]:
    """Read a tree into the given structure; a leaf without a sharding is placed on the first device.

    Args:
        path: Folder written by `save`.
        structure: Shapes, dtypes and shardings of the leaves.
        advice: Advice that ends the error message; by default, how to resume without this checkpoint.

    Raises:
        ResultsError: The checkpoint is missing, damaged, or of another structure.
    """
    ocp = _orbax()
    target, treedef = jax.tree.flatten(structure)
    anywhere = jax.sharding.SingleDeviceSharding(jax.devices()[0])
    plain = {i: jax.eval_shape(_plain, leaf) for i, leaf in enumerate(target) if leaf.size}
    plain = {
        _name(i): jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=target[i].sharding or anywhere)
        for i, leaf in plain.items()
    }
    try:
        _check_files(path)
        with _ONE_AT_A_TIME, _quiet():
            _check_shapes(ocp.metadata(str(path.resolve())).metadata, plain)
            leaves = ocp.load(str(path.resolve()), plain)
    except Exception as error:
        raise ResultsError(
            f"{path}: the checkpoint cannot be read ({error_line(error)}): "
            + (advice or f"delete the folder {path.parent} and resume to compute this chunk again")
        ) from error
    restored = [
        _typed(leaves[_name(i)], leaf) if leaf.size else jnp.empty_like(leaf) for i, leaf in enumerate(target)
    ]
    return jax.tree.unflatten(treedef, restored)


def _check_files(path: Path) -> None:
    """Refuse a checkpoint whose files have changed; checkpoints of early versions have no checksums."""
    checksum = path / _CHECKSUM
    if checksum.exists() and read_checked_json(checksum)["files"] != fingerprint(path, without=_CHECKSUM):
        raise ValueError("its files do not match its checksum")


def _check_shapes(saved: Mapping[str, Any], wanted: Mapping[str, jax.ShapeDtypeStruct]) -> None:
    """Refuse other shapes in one line; Orbax would report a hundred lines for every leaf."""
    if saved.keys() != wanted.keys():
        raise ValueError(f"it has {len(saved)} arrays, not {len(wanted)}")
    for name, leaf in wanted.items():
        if tuple(saved[name].shape) != leaf.shape:
            raise ValueError(f"{name} has shape {tuple(saved[name].shape)}, not {leaf.shape}")


def _plain(leaf: Array) -> Array:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _typed(leaf: Array, target: jax.ShapeDtypeStruct) -> Array:
    if not _is_key(target):
        return leaf
    return jax.random.wrap_key_data(leaf, impl=jax.random.key_impl(jax.numpy.empty(0, target.dtype)))


def _is_key(leaf) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _name(index: int) -> str:
    return f"leaf-{index:04d}"


def _orbax():
    # Importing Orbax takes most of a second, and a short sweep never writes a checkpoint.
    from orbax.checkpoint import v1

    return v1


def _quiet() -> AbstractContextManager[None]:
    """Silence Orbax's log, which would print a traceback for every failed write."""
    return quiet("absl", logging.CRITICAL)
