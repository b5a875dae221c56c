"""Short loops: compiled as loops on a CPU, unrolled on an accelerator."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax

T = TypeVar("T")  # A tree of arrays
MOST_UNROLLED = 32  # largest number of steps that are unrolled


def is_unrolled(number: int) -> bool:
    """Whether a loop of `number` steps is unrolled."""
    # The default backend decides: a wrong guess costs time only, and `jax.lax.platform_dependent` would trace
    # both.
    return number <= MOST_UNROLLED and jax.default_backend() != "cpu"


def short_loop(number: int, step: Callable[[Any, T], T], start: T) -> T:
    """Apply `step(k, x)` for k = 0, ..., number - 1: elementwise arithmetic on small arrays."""
    # On a CPU this is a loop: unrolled, the 16 steps of `guarded_cholesky` take six times as long to compile
    # and are no faster. On a GPU the steps are unrolled, since every iteration of a loop launches kernels of
    # its own.
    if not is_unrolled(number):
        return jax.lax.fori_loop(0, number, step, start)
    for k in range(number):
        start = step(k, start)
    return start
