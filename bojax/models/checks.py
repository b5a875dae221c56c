"""A user's inputs to a model: conversion to arrays, and checks on the host.

Every failure names the allowed values in one line.
"""

import functools
import math
import numbers
import operator
import reprlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any, ParamSpec, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PyTree

from bojax.numerics.construct import construct
from bojax.numerics.trial import is_users, trial_of
from bojax.text import one_line

Numbers: TypeAlias = np.ndarray | np.generic | Sequence[Any] | float | int
"""What may be given instead of an array of JAX: Python numbers, lists of them, and arrays of NumPy."""


P = ParamSpec("P")
R = TypeVar("R")


def precision(*trees: PyTree) -> Any:
    """Data type of the first floating-point array in the trees; without one, JAX's default."""
    leaves = (leaf for leaf in jax.tree.leaves(trees) if eqx.is_inexact_array(leaf))
    return next((jax.dtypes.canonicalize_dtype(leaf.dtype) for leaf in leaves), jnp.result_type(float))


def to_numbers(name: str, given: Any, dtype: Any) -> Array:
    """Numbers as an array of a precision; ValueError if they are not real numbers."""
    return as_numbers(name)(given).astype(dtype)


def to_points(name: str, given: Any, dtype: Any, num_dims: int | None = None) -> Float[Array, "N D"]:
    """Points as the rows of an array of a precision; ValueError if they do not fit.

    On a line, a point may be given as one number, and several points as a list of numbers.
    """
    array = to_numbers(name, given, dtype)
    rows = array.reshape(-1, 1) if array.ndim < 2 else array
    if rows.ndim != 2 or num_dims not in (None, rows.shape[1]):
        allowed = "[points, dimensions]" if num_dims is None else f"[points, {num_dims}]"
        raise ValueError(f"{name}: got shape {array.shape}; allowed: {allowed}")
    return rows


def to_data(
    features: Any, targets: Any, dtype: Any = None
) -> tuple[Float[Array, "N M"], Float[Array, "N *K"]]:
    """Features and targets as arrays, by default of the features' precision; ValueError if they misfit."""
    dtype = precision(features) if dtype is None else dtype
    features, targets = to_points("features", features, dtype), to_numbers("targets", targets, dtype)
    if targets.shape[:1] != features.shape[:1]:
        allowed = f"{len(features)} rows, one for each row of features"
        raise ValueError(f"targets: got shape {targets.shape}; allowed: {allowed}")
    return features, targets


def to_point(name: str, given: Any, dtype: Any, num_dims: int) -> Float[Array, "D"]:
    """One point as an array of a precision (on a line, a number will do); ValueError if it does not fit."""
    array = jnp.atleast_1d(to_numbers(name, given, dtype))
    if array.shape != (num_dims,):
        raise ValueError(f"{name}: got shape {array.shape}; allowed: [{num_dims}]")
    return array


def as_numbers(name: str) -> Callable[[Any], Any]:
    """A converter for a field of a module, from Python numbers, lists and NumPy arrays to JAX arrays.

    Integers become floating-point numbers of JAX's default precision; floating-point arrays keep their
    precision. The converter raises ValueError for anything but an array of real numbers.
    """

    def convert(given: Any) -> Any:
        value = given
        if not hasattr(value, "dtype"):
            has_arrays = any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value))
            try:
                value = jnp.stack(value) if has_arrays else np.asarray(value)
            except (TypeError, ValueError) as error:
                raise _refused(name, given, "numbers") from error
        if jnp.issubdtype(value.dtype, jnp.integer):
            return jnp.asarray(value, jnp.result_type(float))
        if not jnp.issubdtype(value.dtype, jnp.floating):
            raise _refused(name, given, "numbers")
        return jnp.asarray(value) if isinstance(value, np.ndarray | np.generic) else value

    return convert


def by_name(role: str) -> Callable[[Any], Any]:
    """A converter of a field or an argument, from a name or a mapping of settings to the part.

    Names, settings and defaults are those of config files: `"matern52"`, or `{"kind": "matern52",
    "lengthscale": [1, 2]}`. Numbers have JAX's default precision. Anything else is returned as it is. The
    converter raises ConfigError, a ValueError of one line, for an unknown name or a wrong setting.
    """

    def convert(given: Any) -> Any:
        if not isinstance(given, str | Mapping):
            return given
        from bojax.config.catalog import named  # imports the settings of every room

        return construct(named(role, given), str(jnp.result_type(float)))

    return convert


def check_readings(x: tuple[str, Any], y: tuple[str, Any], is_given: Any) -> None:
    """Refuse observations that are not finite: named arrays of inputs and values, and which rows count."""
    for name, values in (x, y):
        rows = np.asarray(values)[np.asarray(is_given)]
        bad = int(np.sum(~np.isfinite(rows)))
        if bad:
            raise ValueError(f"{name}: {bad} of {rows.size} numbers are not finite")


def check_key(value: Any) -> None:
    """Refuse anything but a random key."""
    if not isinstance(value, jax.Array):
        raise _refused("key", value, "a key, such as jax.random.key(0)")


def check_kind(name: str, value: Any, kind: type, example: str) -> None:
    """Refuse anything but an instance of a class."""
    if not isinstance(value, kind):
        raise _refused(name, value, f"an instance of {kind.__name__}, such as {example}")


def check_flag(name: str, value: Any) -> bool:
    """`value`, which must be True or False."""
    if not isinstance(value, bool | np.bool_):
        raise _refused(name, value, "True or False")
    return bool(value)


def check_count(name: str, value: Any, least: int) -> int:
    """`value`, which must be an integer of at least `least`."""
    try:
        number = None if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least:
        raise _refused(name, value, f"an integer >= {least}")
    return number


def check_number(name: str, value: Any, dtype: str, *, is_above: bool = False) -> float:
    """`value`, which must be a number of at least 0, or above it, even after rounding to `dtype`."""
    if isinstance(value, np.ndarray | jax.Array) and value.ndim == 0:
        value = value.item()
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_)
    number = float(_rounded(float(value), dtype)) if is_number else math.nan
    if not math.isfinite(number) or number < 0.0 or (is_above and number == 0.0):
        allowed = f"a number {'>' if is_above else '>='} 0, representable in {dtype}"
        raise _refused(name, value, allowed)
    return float(value)


def check_array(name: str, values: Any, num_axes: int, axes: str, dtype: str) -> np.ndarray:
    """`values` as an array, which must be real and finite, with finite sums of squares in `dtype`."""
    try:
        array = np.asarray(values)
        if array.dtype.kind == "c" or np.any(np.ma.getmaskarray(values)):
            raise TypeError("complex or masked values")
        array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: not an array of numbers: {one_line(error)}") from error
    if array.ndim != num_axes:
        raise ValueError(f"{name}: got shape {array.shape}; allowed: {axes}")
    bad = int(np.sum(~np.isfinite(array)))
    if bad:
        raise ValueError(f"{name}: {bad} of {array.size} numbers are not finite")
    largest, most = np.max(np.abs(array), initial=0.0), 1e-4 * float(np.finfo(dtype).max) ** 0.5
    if largest > most:
        raise ValueError(
            f"{name}: got {largest:g}; allowed: up to {most:.1e}, for finite sums of squares in {dtype}"
        )
    return array


def check_positive(name: str, module: PyTree) -> None:
    """Refuse a module that has a number which is not positive and finite."""
    check_finite(name, module)
    for path, leaf in jax.tree_util.tree_leaves_with_path(module):
        if np.any(np.asarray(leaf) <= 0.0):
            raise ValueError(
                f"{name}{jax.tree_util.keystr(path)}: got {np.asarray(leaf).min():g}; allowed: > 0"
            )


def check_finite(name: str, module: PyTree) -> None:
    """Refuse a module that has a number which is not finite."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(module):
        if not np.all(np.isfinite(np.asarray(leaf))):
            raise ValueError(f"{name}{jax.tree_util.keystr(path)}: got a number that is not finite")


def check_takes(
    name: str,
    function: Any,
    num_points: int,
    num_dims: int,
    dtype: Any,
    of: str = "the columns of X",
    *,
    is_number: bool = True,
) -> None:
    """Refuse a function of points that has another number of dimensions, or a kernel or mean of no number."""
    point = jax.ShapeDtypeStruct((num_dims,), dtype)
    try:
        if getattr(function, "num_dims", num_dims) != num_dims:
            raise ValueError(f"the function takes points of dimension {function.num_dims}")
        with trial_of(type(function).__name__) if is_users(function) else nullcontext():
            value = jax.eval_shape(function, *[point] * num_points)
    except (TypeError, ValueError) as error:
        cause = f": {error}" if is_users(function) else ""
        raise ValueError(f"{name}: does not accept points of dimension {num_dims} ({of}){cause}") from error
    if is_number and getattr(value, "shape", None) != ():
        found = getattr(value, "shape", type(value).__name__)
        raise ValueError(f"{name}: returns {found} for a point; allowed: one number, of shape ()")
    if num_points == 2 and is_users(function) and is_known(function):
        _check_covariance(f"{name}: {type(function).__name__}", function, num_dims, dtype)


def _check_covariance(name: str, kernel: Any, num_dims: int, dtype: Any) -> None:
    """Refuse a kernel whose covariances of points of the unit box are never finite, or of no process."""
    # Kernels of a smaller domain exist, as of logarithms or Brownian motion: nearly all are defined there.
    points = jnp.asarray(np.random.default_rng(0).uniform(size=(_NUM_TRIED, num_dims)), dtype)
    gram = np.asarray(kernel.gram(points, points), np.float64)
    is_finite = np.isfinite(gram)
    if not is_finite.any():
        raise ValueError(f"{name}: no covariance of two points is finite")
    if not is_finite.all():
        return
    slack = _SLACK * max(np.max(np.abs(gram)), np.finfo(dtype).tiny)
    if np.max(np.abs(gram - gram.T)) > slack:
        raise ValueError(f"{name}: k(x, y) differs from k(y, x)")
    if (least := np.linalg.eigvalsh(gram).min()) < -slack:
        got = f"the covariances of {_NUM_TRIED} points have the eigenvalue {least:.3g}"
        raise ValueError(f"{name}: {got}; allowed: no negative ones, as of every covariance function")


_NUM_TRIED = 24
"""Number of points at which a user's kernel is tried."""

_SLACK = 1e-3
"""Largest error of a covariance of single precision, as a share of the largest covariance."""


def is_known(tree: PyTree) -> bool:
    """Whether the values of all leaves of a tree are known: none is traced."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def compiled_if_known(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function as one program for calls with known numbers; a traced call stays as it is."""
    compiled = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return (compiled if is_known((args, kwargs)) else function)(*args, **kwargs)

    return call


def cast(module: PyTree, dtype: Any) -> PyTree:
    """A module with its floating-point arrays converted to `dtype`."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype) if eqx.is_inexact_array(leaf) else leaf, module)


def _rounded(number: float, dtype: str) -> np.ndarray:
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(number, np.float64).astype(dtype)


def _refused(name: str, value: Any, allowed: str) -> ValueError:
    got = f'"{value}"' if isinstance(value, str) else one_line(reprlib.repr(value))
    return ValueError(f"{name}: got {got}; allowed: {allowed}")
