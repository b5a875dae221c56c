"""Reads snapshots from `arrays/` and checks the shapes of their arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.results.store import ResultsError

Arrays = Mapping[str, NDArray[Any]]

SHAPES: Mapping[str, Mapping[str, str]] = {
    "paths": {"paths": "T S 3", "plans": "T S 3", "start": "3", "frames": "T F Q"},
    "belief": {
        **{"x": "X", "y": "Y", "truth": "Y X", "mean": "Y X", "std": "Y X"},
        **{"samples": "N 3", "means": "U V W", "stds": "U V W"},
    },
    "values": {"episodes": "K", "maps": "K 2 ...", "low": "D", "high": "D"},
    "trajectories": {"paths": "K S 3"},
}
"""Shapes of arrays by name of the snapshot. A letter is a size that the arrays of one file share."""


BELIEF = {"x", "y", "truth", "mean", "std"}
"""Arrays of a `belief` snapshot of a field; snapshots without them belong to other problems."""


def read_snapshot(path: Path, name: str) -> Arrays:
    """The arrays of a snapshot."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except Exception as error:  # damaged archives raise many kinds of exceptions
        raise ResultsError(f"{path}: cannot be read: was it truncated?") from error
    if name == "paths" and "paths" not in arrays:
        raise ResultsError(f"{path}: no array paths: not a snapshot of bojax")
    if name == "belief" and not BELIEF <= arrays.keys():
        return arrays  # of a user's problem, which may use the names otherwise
    sizes: dict[str, int] = {}
    for key, shape in SHAPES.get(name, {}).items():
        if key in arrays:
            _check(arrays[key], shape, sizes, f"{path}: {key}")
    return arrays


def _check(array: NDArray[Any], shape: str, sizes: dict[str, int], where: str) -> None:
    if array.dtype.kind not in "biuf":
        raise ResultsError(f"{where}: got values of type {array.dtype}; allowed: numbers")
    axes = shape.removesuffix(" ...").split()
    is_open = shape.endswith("...")
    known = {axis: int(axis) for axis in axes if axis.isdigit()} | sizes
    fits = array.ndim > len(axes) if is_open else array.ndim == len(axes)
    if not fits or any(known.setdefault(*pair) != pair[1] for pair in zip(axes, array.shape, strict=False)):
        wanted = ", ".join(str(sizes.get(axis, axis)) for axis in axes) + (", ..." if is_open else "")
        raise ResultsError(f"{where}: got the shape {list(array.shape)}; allowed: [{wanted}]")
    sizes.update(known)
