"""Third-party packages imported silently, and traced with JAX's default settings.

The engine enables 64-bit numbers, and tests enforce strict promotion of dtypes and ranks. MJX and Brax
support neither: a function wrapped by `standard_jax` is traced as a 32-bit program within a 64-bit one.
"""

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

P = ParamSpec("P")
R = TypeVar("R")


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Suppress the output and the warnings of a package at import or setup, such as MJX's about Warp."""
    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def plain_jax() -> Iterator[None]:
    """JAX's defaults: 32-bit numbers, promotion of dtypes and ranks, no check of key reuse.

    Matrix products keep full precision. In TF32, the default on a GPU, a wheeled robot in MJX is 2e-4 off C
    MuJoCo after 20 steps, instead of 1e-5.
    """
    with (
        jax.enable_x64(False),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
        jax.debug_key_reuse(False),
        jax.default_matmul_precision("highest"),
    ):
        yield


def standard_jax(function: Callable[P, R]) -> Callable[P, R]:
    """Trace a function in `plain_jax`, with 32-bit arguments and strongly typed results.

    Arguments and results are trees of arrays; typed keys are passed as raw keys.
    """

    @wraps(function)
    def traced(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = jax.tree.map(_to_32_bit, (args, kwargs))
        with plain_jax():
            return jax.tree.map(_strongly_typed, function(*args, **kwargs))

    return traced


def _to_32_bit(x: Any) -> Any:
    if not isinstance(x, jax.Array):
        return x
    if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
        return jax.random.key_data(x)
    narrow = {"float64": "float32", "int64": "int32", "uint64": "uint32"}
    return x.astype(narrow.get(x.dtype.name, x.dtype))


def _strongly_typed(x: Any) -> jax.Array:
    x = jnp.asarray(x)
    return jax.lax.convert_element_type(x, x.dtype)
