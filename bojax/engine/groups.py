"""Static groups: points of a sweep that share one compiled program."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from bojax.experiments.base import Experiment


@dataclass(frozen=True, eq=False)
class StaticGroup:
    """Points whose modules have equal tree structure, shapes and dtypes."""

    index: int  # index of the group in the sweep
    points: tuple[int, ...]  # indices of the group's points in the sweep
    # Array leaves whose values differ between points, `[num_points, ...]`; other leaves are None
    swept: PyTree
    shared: PyTree  # array leaves whose values are equal at all points; other leaves are None
    static: PyTree  # leaves that are not arrays

    def swept_at(self, positions: np.ndarray) -> PyTree:
        """The swept leaves of lanes, given the position of each lane's point in the group."""
        return jax.tree.map(lambda leaf: leaf[positions], self.swept)

    def experiment(self, swept: PyTree, shared: PyTree) -> Experiment:
        """The module of one lane."""
        return eqx.combine(swept, shared, self.static)


def static_groups(modules: Sequence[Experiment]) -> list[StaticGroup]:
    """Group the modules of a sweep's points, in the order of their first points."""
    members: dict[Any, list[int]] = {}
    for index, module in enumerate(modules):
        members.setdefault(_signature(module), []).append(index)
    return [
        _group(index, points, [modules[point] for point in points])
        for index, points in enumerate(members.values())
    ]


def nodes_with(module: PyTree, attribute: str) -> dict[tuple, Any]:
    """The outermost nodes of a tree that have an attribute, by their paths."""
    found = jax.tree_util.tree_leaves_with_path(module, is_leaf=lambda node: hasattr(node, attribute))
    return {path: node for path, node in found if hasattr(node, attribute)}


def _group(index: int, points: list[int], modules: list[Experiment]) -> StaticGroup:
    split = [eqx.partition(module, eqx.is_array) for module in modules]
    leaves = [jax.tree.leaves(arrays) for arrays, _ in split]
    columns = [[np.asarray(leaf) for leaf in column] for column in zip(*leaves, strict=True)]
    differs = [any(other.tobytes() != column[0].tobytes() for other in column[1:]) for column in columns]
    structure = jax.tree.structure(split[0][0])
    swept = [np.stack(column) if swept else None for column, swept in zip(columns, differs, strict=True)]
    shared = [None if swept else column[0] for column, swept in zip(columns, differs, strict=True)]
    return StaticGroup(
        index=index,
        points=tuple(points),
        swept=jax.tree.unflatten(structure, swept),
        shared=jax.tree.unflatten(structure, shared),
        static=split[0][1],
    )


def _signature(module: Experiment) -> Any:
    leaves, structure = jax.tree.flatten(module)
    kinds = tuple(
        (leaf.shape, str(leaf.dtype)) if eqx.is_array(leaf) else ("static", leaf) for leaf in leaves
    )
    return structure, kinds
