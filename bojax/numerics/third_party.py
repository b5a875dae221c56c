"""Where code of others is imported and traced: packages that know plain JAX only.

The engine runs with 64-bit numbers, and tests with strict promotion of types and ranks; MJX and Brax are
written for neither. What they trace inside `standard_jax` is a 32-bit program beside the 64-bit one.
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
    """Swallow what a package prints and warns of while it is imported or set up; MJX tells of Warp."""
    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def plain_jax() -> Iterator[None]:
    """JAX as it comes: 32-bit numbers, types and ranks promoted, keys used as often as one likes.

    Only matrix products keep full precision: in TF32, the default on a GPU, a wheeled robot is 2e-4 off C
    MuJoCo after 20 steps of MJX, where 1e-5 is seen without.
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
    """A function that is traced in `plain_jax`, on 32-bit arrays, and returns strongly typed arrays.

    Arguments and results are trees of arrays; typed keys become the raw ones that older code wants.
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
