"""Checks of the values that an experiment returns; a mistake is reported in one line.

The checks run while the experiment is traced and cost nothing at run time.
"""

from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Array, PyTree

from bojax.engine.errors import EngineError
from bojax.errors import FAILURE
from bojax.experiments.base import Carry, Experiment
from bojax.results.schema import Table, column_names

VALID = "valid"
"""The column of every record table that marks its valid rows; it is not stored."""


def check_init(experiment: Experiment, carry: Carry) -> None:
    """Raise if a leaf of the carry is weakly typed: `advance` would change its type."""
    for path, leaf in jax.tree.leaves_with_path(carry):
        if not hasattr(leaf, "dtype") or getattr(leaf, "weak_type", False):
            where = jax.tree_util.keystr(path)
            raise _error(experiment, f"init: carry{where} is a Python number: use jnp.asarray(value, dtype)")


def check_advance(experiment: Experiment, before: Carry, after: Carry) -> None:
    """Raise unless `advance` keeps the structure, shapes and dtypes of the carry."""
    old, new = jax.tree.structure(before), jax.tree.structure(after)
    if old != new:
        raise _error(experiment, f"advance: the carry's structure changes from {old} to {new}")
    leaves = zip(jax.tree.leaves_with_path(before), jax.tree.leaves(after), strict=True)
    for (path, was), now in leaves:
        if _type(was) != _type(now):
            where = jax.tree_util.keystr(path)
            raise _error(experiment, f"advance: carry{where} changes from {_type(was)} to {_type(now)}")


def check_records(experiment: Experiment, records: Mapping[str, Mapping[str, Array]]) -> None:
    """Raise unless every record table has `valid` and the columns of its schema, all of one length."""
    for name, columns in records.items():
        if name not in experiment.tables:
            raise _error(experiment, f"advance: unknown table {name!r}: declare it in `tables`")
        if VALID not in columns:
            raise _error(experiment, f"advance: table {name!r} has no column {VALID!r}")
        stored = {key: column for key, column in columns.items() if key != VALID}
        _check_columns(experiment, f"advance: table {name!r}", stored, experiment.tables[name])
        shapes = {column.shape for column in columns.values()}
        if len(shapes) > 1 or len(next(iter(shapes))) != 1:
            raise _error(
                experiment, f"advance: table {name!r}: got shapes {sorted(shapes)}; allowed: one shape [rows]"
            )


def check_summary(experiment: Experiment, summary: Mapping[str, Array]) -> None:
    """Raise unless the summary has the columns of the table `runs`, all of them scalars."""
    _check_columns(experiment, "summary", summary, experiment.tables["runs"])
    for name, value in summary.items():
        if value.shape:
            raise _error(experiment, f"summary: {name!r} has shape {value.shape}; allowed: a scalar, ()")


def _check_columns(experiment: Experiment, where: str, columns: Mapping[str, Array], table: Table) -> None:
    found, declared = set(columns), set(column_names(table))
    if missing := sorted(declared - found):
        raise _error(experiment, f"{where}: column {missing[0]!r} is declared in `tables`, but missing")
    if unknown := sorted(found - declared):
        raise _error(experiment, f"{where}: column {unknown[0]!r} is not declared in `tables`")
    for column in table:
        dtype, wanted = columns[column.name].dtype, "int32" if column.words else column.dtype
        if wanted == "string" or not np.can_cast(dtype, np.dtype(wanted), "same_kind"):
            raise _error(experiment, f"{where}: {column.name!r} is {dtype}; `tables` declares {wanted}")


def _type(leaf: PyTree) -> str:
    return f"{leaf.dtype}{list(leaf.shape)}"


def _error(experiment: Experiment, message: str) -> EngineError:
    return EngineError(f"{type(experiment).__module__}:{type(experiment).__qualname__}.{message}", FAILURE)
