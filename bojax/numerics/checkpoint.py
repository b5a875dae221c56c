"""Checkpoints: trees of arrays in npz files, restored to a given structure and given devices.

Arrays are named after their place in the tree, such as `state.position`. Typed keys are saved as their key
data. A member of an npz file has a checksum (CRC-32), which NumPy verifies.
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from bojax.results.store import ResultsError, write_arrays
from bojax.text import error_line


def save(path: Path, tree: PyTree[Array]) -> None:
    """Write a tree to a file, which appears once it is complete.

    Raises:
        ResultsError: The file cannot be written.
    """
    write_arrays(path, {name: _plain(leaf) for name, leaf in _named(tree)})


def restore(path: Path, structure: PyTree[jax.ShapeDtypeStruct], advice: str | None = None) -> PyTree[Array]:
    """Read a tree of the given structure; a leaf without a sharding is placed on the first device.

    Args:
        path: File written by `save`.
        structure: Shapes, dtypes and shardings of the leaves.
        advice: Advice that ends the error message; by default, how to resume without this checkpoint.

    Raises:
        ResultsError: The file is missing, damaged, or holds a tree of another structure.
    """
    named = _named(structure)
    try:
        with np.load(path, allow_pickle=False) as saved:
            if set(saved) != {name for name, _ in named}:
                raise ValueError("its arrays are not those of this program")
            leaves = [_typed(name, saved[name], target) for name, target in named]
    except Exception as error:  # a damaged file raises many types of exceptions
        raise ResultsError(
            f"{path}: the checkpoint cannot be read ({error_line(error)}): "
            + (advice or f"delete the folder {path.parent} and resume to compute this chunk again")
        ) from error
    return jax.tree.unflatten(jax.tree.structure(structure), leaves)


def _named(tree: PyTree) -> list[tuple[str, Any]]:
    return [
        ("state" + jax.tree_util.keystr(path), leaf)
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    ]


def _plain(leaf):
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _typed(name: str, values: np.ndarray, target: jax.ShapeDtypeStruct) -> Array:
    """The values as an array of the target's dtype, on its device."""
    plain = jax.eval_shape(_plain, target)
    if values.shape != plain.shape:
        raise ValueError(f"{name} has shape {values.shape}, not {plain.shape}")
    if values.dtype.kind == "V" and values.dtype.itemsize == plain.dtype.itemsize:
        values = values.view(plain.dtype)  # NumPy does not know the dtypes that JAX adds, such as bfloat16
    if values.dtype != plain.dtype:
        raise ValueError(f"{name} has dtype {values.dtype}, not {plain.dtype}")
    array = jax.device_put(values, target.sharding or jax.devices()[0])
    return jax.random.wrap_key_data(array, impl=_key_impl(target)) if _is_key(target) else array


def _key_impl(target: jax.ShapeDtypeStruct) -> str:
    return str(jax.random.key_impl(jnp.empty(0, target.dtype)))


def _is_key(leaf) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
