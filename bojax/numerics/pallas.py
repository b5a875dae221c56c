"""Kernels written in Pallas for NVIDIA GPUs, for parts of a program that XLA turns into many kernels.

In the loop of a search, each kernel takes 1 us or more on an H200, however small its work is.
"""

import contextlib
import functools
import importlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, TypeVar

import jax
import jax.extend

T = TypeVar("T")  # A tree of arrays

_is_elsewhere: ContextVar[bool] = ContextVar("is_elsewhere", default=False)


def kernels_run_here() -> bool:
    """Whether the device is an NVIDIA GPU for which Pallas has kernels: of compute capability 8.0 or more.

    A later version of JAX may have no Triton, which is deprecated in 0.11: programs of XLA replace kernels.
    """
    capability = getattr(jax.devices()[0], "compute_capability", "")
    version = re.fullmatch(r"(\d+)\.\d+", capability)
    if version is None or int(version[1]) < 8:
        return False
    try:
        imported()
    except ImportError:
        return False
    return True


@contextlib.contextmanager
def for_another_machine() -> Iterator[None]:
    """Context in which modules are built whose programs another machine runs: this one may lack its GPU."""
    token = _is_elsewhere.set(True)
    try:
        yield
    finally:
        _is_elsewhere.reset(token)


def builds_for_another_machine() -> bool:
    """Whether modules are built for another machine now, see `for_another_machine`."""
    return _is_elsewhere.get()


def either(is_kernel: bool, kernel: Callable[..., T], otherwise: Callable[..., T], *args: Any) -> T:
    """`kernel(*args)` if `is_kernel`, else `otherwise(*args)`, as on the host's CPU, for trees of arrays."""
    if not is_kernel:
        return otherwise(*args)
    return jax.lax.platform_dependent(*args, cuda=kernel, default=otherwise)


def imported() -> tuple[Any, Any]:
    """Pallas and its Triton, which take a second to import."""
    pallas = importlib.import_module("jax.experimental.pallas")
    return pallas, importlib.import_module("jax.experimental.pallas.triton")


@functools.cache
def _fused_product() -> Any:
    """The primitive of `fused_product`; None if this version of JAX cannot lower it.

    JAX has no such operation, but MLIR has. Triton in XLA never fuses a product with a sum by itself.
    """
    product = jax.extend.core.Primitive("fused_product")
    product.def_abstract_eval(lambda x, y, z: x)
    try:
        lowering: Any = importlib.import_module("jax._src.pallas.triton.lowering")
        fma: Any = importlib.import_module("jaxlib.mlir.dialects.math").fma
        lower, operand = lowering.register_lowering(product), lowering._ensure_ir_value
    except (ImportError, AttributeError):
        return None
    lower(lambda context, *xs: fma(*map(operand, xs, context.avals_in)))
    return product


def fused_product(x: jax.Array, y: jax.Array, z: jax.Array) -> jax.Array:
    """The sum x y + z in a kernel, as one operation that rounds once; an interpreted kernel rounds twice."""
    product = None if jax.default_backend() == "cpu" else _fused_product()
    return x * y + z if product is None else product.bind(x, y, z)


def power_of_two(number: int) -> int:
    """The least power of two that is not below a number: the sizes of arrays in a kernel."""
    return 1 << (number - 1).bit_length()


def barrier() -> None:
    """Wait, in a kernel, until all threads of its program are here; an interpreted kernel has only one."""
    if jax.default_backend() != "cpu":
        imported()[1].debug_barrier()


def launch(
    body: Callable[..., None],
    results: Sequence[jax.ShapeDtypeStruct],
    *args: jax.Array,
    name: str,
    grid: tuple[int, ...] = (),
    warps: int = 1,
    stages: int = 1,
    in_place: Mapping[int, int] | None = None,
) -> Sequence[jax.Array]:
    """The results of a kernel for a single lane; `vmap` adds the lanes to its grid. A CPU interprets it.

    Args:
        body: Reads references to the arguments, and writes to those of the results, which come after them.
        results: Shapes of the results.
        args: The arguments.
        name: Name of the kernel, for profilers.
        grid: Number of programs of a lane.
        warps: Number of warps of a program.
        stages: Number of iterations of a loop whose operands Triton loads at a time.
        in_place: Arguments that are copied to a result before the kernel starts, as numbers of both.
    """
    pallas, triton = imported()
    call = pallas.pallas_call(
        body,
        out_shape=list(results),
        grid=grid,
        input_output_aliases=dict(in_place or {}),
        interpret=jax.default_backend() == "cpu",
        compiler_params=triton.CompilerParams(num_warps=warps, num_stages=stages),
        name=name,
    )
    return call(*args)
