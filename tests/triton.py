"""Kernels of scalars as JAX lowers them to Triton, interpreted: a GPU's program on a machine without one."""

import importlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from tests.compiling import as_for_a_gpu

TYPES = {f"{kind}{bits}": np.dtype(f"{kind}{bits // 8}") for kind in "if" for bits in (16, 32, 64)}
TYPES |= {"i1": np.dtype(bool), "i8": np.dtype(np.int8)}


def interpreted(monkeypatch, kernel: Callable[..., Any], *examples: np.ndarray) -> Callable[..., Any]:
    """The function of flat arrays that a kernel is on a GPU, one operation after the other.

    The arrays are those of the kernel's only `pallas_call`, in the same order.
    """
    modules, registration = [], importlib.import_module("jax._src.pallas.triton.pallas_call_registration")
    lower = registration.lowering.lower_jaxpr_to_triton_module

    def keep(*args, **settings):
        lowered = lower(*args, **settings)
        modules.append(lowered.module)
        return lowered

    with monkeypatch.context() as patch, as_for_a_gpu(patch):
        patch.setattr(registration.lowering, "lower_jaxpr_to_triton_module", keep)
        shapes = jax.tree.leaves(jax.eval_shape(kernel, *examples))
        jax.jit(kernel).trace(*examples).lower(lowering_platforms=("cuda",))
    ((function,),) = (module.body.operations for module in modules)

    def call(*arrays: np.ndarray) -> list[np.ndarray]:
        results = [np.zeros(x.shape, x.dtype) for x in shapes]
        words = [_signed(x) for x in (*map(np.array, arrays), *results)]
        with modules[0].context:
            _run(function.operation.regions[0].blocks[0], {}, [(x, 0) for x in words])
        return results

    return call


def _signed(x: np.ndarray) -> np.ndarray:
    """The same memory as Triton sees it, which has no unsigned integers."""
    return x.view(f"i{x.itemsize}") if x.dtype.kind == "u" else x


def _run(block: Any, values: dict[Any, Any], arguments: Any) -> list[Any]:
    values |= dict(zip(block.arguments, arguments, strict=True))
    for op in (each.operation for each in block.operations):
        operands = [values[operand] for operand in op.operands]
        if op.name in ("tt.return", "scf.yield", "scf.condition"):
            return operands
        if op.name == "scf.while":
            state, (condition, body) = operands, (region.blocks[0] for region in op.regions)
            while (found := _run(condition, values, state))[0]:
                state = _run(body, values, found[1:])
            values |= dict(zip(op.results, found[1:], strict=True))
        elif op.name == "tt.store":
            (array, place), value = operands
            array[place] = value
        else:
            values[op.results[0]] = _computed(op, *operands)
    return []


def _computed(op: Any, *xs: Any) -> Any:
    """The result of an operation; a pointer is an array and a place in it."""
    kind, name = str(op.results[0].type), op.name.split(".")[1]
    if kind.startswith("!tt.ptr"):
        return (xs[0][0], xs[0][1] + int(xs[1])) if name == "addptr" else xs[0]
    dtype = TYPES[kind]
    bits = 8 * dtype.itemsize
    unsigned = [x.view(f"u{x.itemsize}") if x.dtype.kind == "i" else x for x in xs if hasattr(x, "view")]
    with np.errstate(all="ignore"):
        if name == "load":
            return xs[0][0][xs[0][1]]
        if name == "constant":
            text = str(op.attributes["value"]).split(" : ")[0]
            if dtype.kind == "b":
                return np.bool_(text == "true")
            if dtype.kind == "f" and not text.startswith("0x"):
                return dtype.type(text)
            return np.array(int(text, 0) % (1 << bits), f"u{dtype.itemsize}").view(dtype)[()]
        if name == "extern_elementwise":
            symbol = str(op.attributes["symbol"]).strip('"').removeprefix("__nv_").removesuffix("f")
            return dtype.type({"fabs": np.abs}.get(symbol, getattr(np, symbol, None))(*xs))
        if name in ("cmpi", "cmpf"):
            predicate = int(str(op.attributes["predicate"]).split(" ")[0])
            return np.bool_(_COMPARED[name][predicate](*(unsigned if predicate > 5 else xs)))
        if name == "select":
            return xs[1] if xs[0] else xs[2]
        if name == "bitcast":
            return np.asarray(xs[0]).view(dtype)[()]
        if name in ("extui", "trunci"):
            word = np.array(int(unsigned[0]) % (1 << bits), f"u{dtype.itemsize}")
            return np.bool_(word & 1) if dtype.kind == "b" else word.view(dtype)[()]
        if name in _OF_UNSIGNED:
            return _OF_UNSIGNED[name](*unsigned).view(dtype)
        return dtype.type(_OPERATIONS[name](*xs))


_ORDERS = np.less, np.less_equal, np.greater, np.greater_equal

_COMPARED: dict[str, dict[int, Callable[..., Any]]] = {
    "cmpi": dict(enumerate((np.equal, np.not_equal, *_ORDERS, *_ORDERS))),
    "cmpf": {
        **dict(enumerate((np.equal, np.greater, np.greater_equal, np.less, np.less_equal), 1)),
        13: np.not_equal,
        14: lambda x, y: np.isnan(x) or np.isnan(y),
    },
}
"""Comparisons by the numbers that MLIR gives them; those of integers end with the unsigned ones."""

_OF_UNSIGNED: dict[str, Callable[..., Any]] = {
    "shrui": np.right_shift,
    "divui": np.floor_divide,
    "remui": np.remainder,
}

_OPERATIONS: dict[str, Callable[..., Any]] = {
    **dict.fromkeys(("addi", "addf"), np.add),
    **dict.fromkeys(("subi", "subf"), np.subtract),
    **dict.fromkeys(("muli", "mulf"), np.multiply),
    "divf": np.divide,
    "negf": np.negative,
    "andi": np.bitwise_and,
    "ori": np.bitwise_or,
    "xori": np.bitwise_xor,
    "shli": np.left_shift,
    "maxnumf": np.fmax,
    "minnumf": np.fmin,
    **dict.fromkeys(("maxsi", "maximumf"), np.maximum),
    **dict.fromkeys(("minsi", "minimumf"), np.minimum),
    "fma": lambda x, y, z: np.longdouble(x) * y + z,
    **dict.fromkeys(("extf", "truncf", "sitofp", "fptosi", "extsi"), lambda x: x),
    "uitofp": lambda x: int(x) if x >= 0 else int(x) + (1 << 8 * x.itemsize),
    "get_program_id": lambda: 0,
    **{name: getattr(np, name) for name in ("sqrt", "exp", "log", "sin", "cos", "floor", "log1p")},
    "absf": np.abs,
}
