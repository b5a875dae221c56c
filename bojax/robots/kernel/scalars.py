"""Compile functions of small arrays into scalar programs, for kernels with one warp per lane.

A function is traced for a single lane, and its arrays are taken apart into elements. Operations that only
move elements disappear, products with a known 0 too, and equal operations are computed once. Thousands of
operations on small arrays, in the step of a robot, become about as many on scalars.

Deviations: a product with a known 0 is 0, without a sign, even if the other factor is infinite or no number.
On a GPU, the maximum and the minimum of a number and NaN are the number, unless a program keeps NaN. The
Cholesky factor of a matrix that is not positive definite has NaN from the first negative pivot on, where JAX
has NaN everywhere; a pivot of 0 is only seen by the entries below it.
"""

import dataclasses
import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.random import threefry_prng_impl
from jax.lax import GatherScatterMode

from bojax.numerics.pallas import fused_product
from bojax.numerics.simulation_keys import is_key, threefry


class NotScalar(Exception):
    """A function has an unsupported operation, or indexes an array by computed numbers."""


@dataclasses.dataclass(eq=False)
class Scalar:
    """A scalar computed by the program; known numbers are scalars of NumPy instead."""

    number: int  # greater than those of the operands
    level: int  # number of loops around the scalar; invariants of a loop are outside of it
    operands: Sequence[Any]  # what it is computed from: scalars and known scalars
    compute: Callable[..., Any] | None  # the operation, given the values of the operands; None for an input
    dtype: np.dtype


class ScalarProgram:
    """A function of scalars, on values of any one shape."""

    def __init__(
        self,
        function: Callable[..., Any],
        *examples: Any,
        most: int = 100_000,
        keeps_nan: bool = False,
        fuses: bool = False,
    ):
        """Trace a function.

        Args:
            function: A function of arrays for a single lane.
            examples: Arrays, or shapes with dtypes, as its arguments.
            most: Largest number of scalars.
            keeps_nan: Whether the maximum and the minimum of a number and NaN are NaN in a kernel, too, which
                takes Triton further operations.
            fuses: Whether products are fused with sums, and rounded once, in a kernel.

        Raises:
            NotScalar: It cannot be taken apart, has too many scalars, or has no arguments.
        """
        traced = jax.make_jaxpr(function)(*examples)
        tracing = _Tracing(most, keeps_nan, fuses)
        arguments = [tracing.inputs(v.aval) for v in traced.jaxpr.invars]
        # The caller may be traced itself, but known numbers are computed now.
        with jax.ensure_compile_time_eval():
            results = tracing.evaluate(traced.jaxpr, traced.consts, arguments)
        self.inputs = _elements(arguments)
        if not self.inputs:
            raise NotScalar("no arguments, whose shape the results could have")
        self.outputs = _elements(results, [v.aval for v in traced.jaxpr.outvars])

    def __call__(self, values: Sequence[jax.Array]) -> list[jax.Array]:
        """The values of the outputs, given those of the inputs."""
        return self.evaluate(slice(None), dict(zip(self.inputs, values, strict=True)))

    def evaluate(self, outputs: slice, values: dict[Scalar, Any]) -> list[jax.Array]:
        """The values of some outputs, given those of the inputs that they depend on.

        The scalars between them get values, too: other outputs are computed from these later.
        """
        return _computed(self.outputs[outputs], values)


def _by_jax(name: str) -> Callable[..., Any]:
    """An operation of JAX on known operands, for cases that NumPy decides otherwise."""
    return lambda *operands: np.asarray(getattr(lax, name)(*operands))


def _of_floats(name: str, compute: Callable[..., Any]) -> Callable[..., Any]:
    """NumPy on floats, JAX on integers, where NumPy raises an exception for a division by 0."""
    return lambda x, y: (compute if np.issubdtype(x.dtype, np.floating) else _by_jax(name))(x, y)


_UFUNCS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": _of_floats("div", np.divide),
    "rem": _of_floats("rem", np.fmod),
    "neg": np.negative,
    "abs": np.abs,
    "sign": _by_jax("sign"),
    # 0 is larger than -0, and the operand that is not a number is the result.
    "max": _by_jax("max"),
    "min": _by_jax("min"),
    "floor": np.floor,
    "ceil": np.ceil,
    "square": np.square,
    "sqrt": np.sqrt,
    "rsqrt": _by_jax("rsqrt"),
    "pow": np.power,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan2": np.arctan2,
    "tanh": np.tanh,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "shift_left": _by_jax("shift_left"),
    "shift_right_logical": _by_jax("shift_right_logical"),
    "is_finite": np.isfinite,
    "log1p": _by_jax("log1p"),
}
"""Elementwise operations, and those of NumPy for known operands."""


_OF_FUNCTIONS = "scan", "while", "cond", "reduce", "reduce_window", "pallas_call"
"""Operations that do not call the function among their parameters just once."""


_OF_KEYS = (
    *("random_wrap", "random_unwrap", "random_fold_in", "random_bits", "random_split"),
    *("slice", "squeeze", "unstack"),
)
"""Operations on keys that have a rule."""


class _Tracing:
    """The scalars of one program, in the order of their computation."""

    def __init__(self, most: int, keeps_nan: bool, fuses: bool):
        self._numbers, self._most, self._level = itertools.count(), most, 0
        self._keeps_nan, self._fuses = keeps_nan, fuses
        self._found: dict[Any, Scalar] = {}

    # ---- scalars

    def scalar(self, operands: Sequence[Any], compute: Callable[..., Any] | None, dtype: Any) -> Scalar:
        number = next(self._numbers)
        dtype = np.dtype(dtype)
        if number > self._most:
            raise NotScalar("too many scalars")
        if dtype.kind not in "biu" and dtype.name not in ("float32", "float64"):
            raise NotScalar(f"numbers of type {dtype}, which Triton has few operations of")
        # An operation belongs to the innermost loop that changes one of its operands, not to the loop that
        # it is written in: what a loop does not change is computed once, before it.
        level = max((x.level for x in operands if isinstance(x, Scalar)), default=0)
        return Scalar(number, level, operands, compute, dtype)

    def inputs(self, aval: Any) -> np.ndarray:
        """An array of unknown scalars: an argument, or the carry of a loop."""
        if is_key(aval):
            raise NotScalar("a key as an argument")
        if aval.size > self._most:  # before they are made
            raise NotScalar("too many scalars")
        dtype = np.dtype(aval.dtype)
        return _each(
            lambda _: Scalar(next(self._numbers), self._level, (), None, dtype), np.empty(aval.shape)
        )

    def apply(self, name: str, compute: Callable[..., Any], operands: Sequence[Any], dtype: Any) -> Any:
        """An elementwise operation on scalars, or its result if that is known."""
        # Folded here rather than left to the compiler: zeros of a model's sparse arrays must be known when
        # products with them are met, and the time of Triton grows with the number of operations.
        if not any(isinstance(x, Scalar) for x in operands):
            if name == "select_n":
                return _selected(*operands)
            with np.errstate(all="ignore"):
                return np.dtype(dtype).type(_UFUNCS[name](*operands))
        if name in ("max", "min"):
            if np.dtype(dtype) == np.bool_:  # Triton has these of numbers only
                name = "or" if name == "max" else "and"
                compute = _operation(name)
            elif self._keeps_nan and np.issubdtype(dtype, np.floating):
                compute = functools.partial(_or_nan, compute)
        simple = _simplified(name, operands, dtype)
        if simple is not None:
            return simple
        # Scalars are compared by identity, known numbers by their bytes: 0 and -0 are equal as numbers.
        parts = (x if isinstance(x, Scalar) else (x.dtype, x.tobytes()) for x in operands)
        key = name, np.dtype(dtype), *parts
        if key not in self._found:
            self._found[key] = self.fused(name, self.scalar(operands, compute, dtype))
        return self._found[key]

    def fused(self, name: str, whole: Scalar) -> Scalar:
        """A sum or a difference as one operation with a product among its operands, if there is one."""
        if not self._fuses or name not in ("add", "sub") or not np.issubdtype(whole.dtype, np.floating):
            return whole
        first, second = whole.operands

        def negated(x: Any) -> Any:
            return self.apply("neg", lax.neg, [x], whole.dtype) if name == "sub" else x

        def is_product(x: Any) -> bool:
            # One of an outer loop is computed once.
            return isinstance(x, Scalar) and x.compute is lax.mul and x.level == whole.level

        # The product stays a scalar, which is left out if nothing else needs it.
        if is_product(second):
            operands = negated(second.operands[0]), second.operands[1], first
        elif is_product(first):
            operands = *first.operands, negated(second)
        else:
            return whole
        return self.scalar(operands, fused_product, whole.dtype)

    # ---- arrays of scalars

    def elementwise(self, name: str, arrays: Sequence[np.ndarray], dtype: Any) -> np.ndarray:
        compute = _operation(name)
        return _tidy(_each(lambda *x: self.apply(name, compute, x, dtype), *arrays), dtype)

    def total(self, name: str, parts: Sequence[Any], dtype: Any) -> Any:
        """The sum of scalars by pairs, or another associative operation of them."""
        compute = _operation(name)
        if self._fuses and name == "add":  # a term that is a product costs nothing in a chain
            chains = (parts[i : i + _CHAIN] for i in range(0, len(parts), _CHAIN))
            parts = [
                functools.reduce(lambda x, y: self.apply(name, compute, (x, y), dtype), c) for c in chains
            ]
        # By pairs, since a chain has a larger rounding error, and each addition waits for the one before.
        while len(parts) > 1:
            half = len(parts) // 2
            pairs = zip(parts[:half], parts[half : 2 * half], strict=True)
            parts = [self.apply(name, compute, pair, dtype) for pair in pairs] + list(parts[2 * half :])
        return parts[0]

    def evaluate(self, jaxpr: Any, consts: Sequence[Any], arguments: Sequence[Any]) -> list[np.ndarray]:
        """The results of a traced function; an array of known numbers alone is an array of NumPy."""
        words = (jax.random.key_data(x) if is_key(x) else x for x in consts)
        values = dict(zip(jaxpr.constvars, map(np.asarray, words), strict=True))
        values |= dict(zip(jaxpr.invars, arguments, strict=True))

        def read(v: Any) -> np.ndarray:
            return np.asarray(v.val, v.aval.dtype) if hasattr(v, "val") else values[v]

        for eqn in jaxpr.eqns:
            values |= dict(zip(eqn.outvars, self.results(eqn, [read(v) for v in eqn.invars]), strict=True))
        return [read(v) for v in jaxpr.outvars]

    def results(self, eqn: Any, arrays: list[np.ndarray]) -> list[np.ndarray]:
        """The results of one operation on arrays."""
        name, params = eqn.primitive.name, eqn.params
        # Functions within functions (jit, custom derivatives) are evaluated in place; loops have rules below.
        for called in ("jaxpr", "call_jaxpr", "call"):
            if called in params and name not in _OF_FUNCTIONS:
                return self.evaluate(*_opened(params[called]), arrays)
        is_of_keys = any(is_key(v.aval) for v in (*eqn.invars, *eqn.outvars))
        if not eqn.outvars or (is_of_keys and name not in _OF_KEYS):
            raise NotScalar(f"{name}, of keys or without results")
        aval = _of_words(eqn.outvars[0].aval)
        if name in _UFUNCS or name == "select_n":
            if name == "select_n" and arrays[0].ndim == 0:
                arrays[0] = np.broadcast_to(arrays[0], arrays[1].shape)
            if len(arrays) > 3:  # Triton chooses between two
                return [self.chosen(arrays[0], arrays[1:], aval.dtype, eqn.invars[0].aval.dtype)]
            return [self.elementwise(name, arrays, aval.dtype)]
        if name in _MOVES:
            return [np.asarray(_MOVES[name](params, aval, *arrays))]
        rule = getattr(self, "_" + name.replace("-", "_"), None)
        if rule is not None:
            found = rule(eqn, *arrays)
            return found if isinstance(found, list) else [found]
        arrays = [_tidy(x, v.aval.dtype) for x, v in zip(arrays, eqn.invars, strict=True)]
        if name not in _OF_KNOWN or any(x.dtype == object for x in arrays):
            raise NotScalar(name)
        return list(_OF_KNOWN[name](params, aval, *arrays))

    # ---- operations that are not elementwise

    def _call_hi_primitive(self, eqn: Any, *arrays: np.ndarray) -> list[np.ndarray]:
        # JAX 0.12 has a few functions, as `nonzero`, that it expands only when a program is lowered.
        prim = eqn.params["_prim"]
        expanded = jax.make_jaxpr(prim.expand)(*prim.in_avals)
        return self.evaluate(expanded.jaxpr, expanded.consts, arrays)

    def _clamp(self, eqn: Any, low: Any, x: Any, high: Any) -> np.ndarray:
        dtype = eqn.outvars[0].aval.dtype
        return self.elementwise("min", [self.elementwise("max", [x, low], dtype), high], dtype)

    def _integer_pow(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        if eqn.params["y"] < 1:
            raise NotScalar("a power that is not positive")
        powers, dtype = itertools.repeat(x, eqn.params["y"]), eqn.outvars[0].aval.dtype
        return functools.reduce(lambda a, b: self.elementwise("mul", [a, b], dtype), powers)

    def _convert_element_type(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        return self.converted(x, np.dtype(eqn.params["new_dtype"]))

    def converted(self, x: np.ndarray, new: np.dtype) -> np.ndarray:
        """An array of another type."""
        convert = functools.partial(lax.convert_element_type, new_dtype=new)

        def known(x: Any) -> Any:
            # JAX takes the nearest integer for a float that is out of range, and 0 for NaN; NumPy any number.
            is_cut = np.issubdtype(x.dtype, np.floating) and np.issubdtype(new, np.integer)
            return np.asarray(convert(jnp.asarray(x))) if is_cut else x.astype(new)

        def one(e: Any) -> Any:
            if not isinstance(e, Scalar):
                return known(e)[()]
            return e if e.dtype == new else self.apply(f"to {new}", convert, [e], new)

        return known(x) if x.dtype != object else _tidy(_each(one, x), new)

    def _bitcast_convert_type(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        old, new = (np.dtype(v.aval.dtype) for v in (eqn.invars[0], eqn.outvars[0]))
        if old.itemsize != new.itemsize:
            raise NotScalar("a change of type to another size")
        convert = functools.partial(lax.bitcast_convert_type, new_dtype=new)
        if x.dtype != object:
            return x.view(new)
        return _each(lambda e: self.apply(f"as {new}", convert, [e], new), x)

    def _cumsum(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        axis, dtype = eqn.params["axis"], eqn.outvars[0].aval.dtype
        x = np.moveaxis(x, axis, 0)
        sums = [np.asarray(each) for each in (x[::-1] if eqn.params["reverse"] else x)]
        for i in range(1, len(sums)):
            sums[i] = self.elementwise("add", [sums[i - 1], sums[i]], dtype)
        sums = np.stack(_alike(sums[::-1] if eqn.params["reverse"] else sums)) if sums else x
        return np.moveaxis(sums, 0, axis)

    def _argmax(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        dtype, number = eqn.outvars[0].aval.dtype, eqn.invars[0].aval.dtype
        best, *rest = (np.asarray(each) for each in np.moveaxis(x, eqn.params["axes"][0], 0))
        place = np.zeros(best.shape, dtype)
        for k, each in enumerate(rest, 1):
            is_better = self.elementwise("gt", [each, best], bool)
            if np.issubdtype(number, np.floating):  # the first that is no number
                is_first = self.elementwise("eq", [best, best], bool)
                is_none = self.elementwise(
                    "and", [self.elementwise("ne", [each, each], bool), is_first], bool
                )
                is_better = self.elementwise("or", [is_better, is_none], bool)
            best = self.elementwise("select_n", [is_better, best, each], number)
            place = self.elementwise("select_n", [is_better, place, np.full(place.shape, k, dtype)], dtype)
        return place

    def _dynamic_slice(self, eqn: Any, x: np.ndarray, *starts: np.ndarray) -> np.ndarray:
        for axis, (start, size) in enumerate(zip(starts, eqn.params["slice_sizes"], strict=True)):
            parts = [x.take(range(k, k + size), axis) for k in range(x.shape[axis] - size + 1)]
            # Compared as they are: a large unsigned number would be a negative one as an integer of 32 bits.
            number = np.dtype(eqn.invars[1 + axis].aval.dtype)
            if number.itemsize < 4:
                start, number = self.converted(start, np.dtype(np.int32)), np.dtype(np.int32)
            x = self.chosen(start, parts, eqn.outvars[0].aval.dtype, number)
        return x

    def chosen(
        self, index: np.ndarray, cases: Sequence[np.ndarray], dtype: Any, number: Any = np.int32
    ) -> np.ndarray:
        """The array of an index of type `number`; for an index out of range, the first or the last.

        Scalars cannot be indexed by a computed number: comparisons choose among all of them.
        """
        found = cases[0]
        for k in range(1, len(cases)):
            reaches = self.elementwise("ge", [index, np.asarray(k, number)], bool)
            reaches = np.broadcast_to(reaches, found.shape)
            found = self.elementwise("select_n", [reaches, found, cases[k]], dtype)
        return found

    # ---- random numbers: a key is its words, along the last axis

    def _random_wrap(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        return x

    _random_unwrap = _random_wrap

    def _random_fold_in(self, eqn: Any, keys: np.ndarray, data: np.ndarray) -> np.ndarray:
        return self._by_words(eqn, threefry_prng_impl.fold_in, keys, data)

    def _random_bits(self, eqn: Any, keys: np.ndarray) -> np.ndarray:
        width, shape = eqn.params["bit_width"], eqn.params["shape"]
        return self._by_words(eqn, lambda words: threefry_prng_impl.random_bits(words, width, shape), keys)

    def _random_split(self, eqn: Any, keys: np.ndarray) -> np.ndarray:
        return self._by_words(eqn, lambda words: threefry_prng_impl.split(words, eqn.params["shape"]), keys)

    def _by_words(self, eqn: Any, function: Any, keys: np.ndarray, *data: Any) -> np.ndarray:
        """The results of a function of the words of a key, and of numbers, for each key."""
        of_keys, *of_data = (v.aval for v in eqn.invars)
        if of_keys.dtype != jax.random.key(0, impl="threefry2x32").dtype:
            raise NotScalar("keys of another kind than Threefry's")
        one = [jax.ShapeDtypeStruct((), aval.dtype) for aval in of_data]
        traced = jax.make_jaxpr(function)(jax.ShapeDtypeStruct((2,), np.uint32), *one)
        shape = np.broadcast_shapes(of_keys.shape, *(aval.shape for aval in of_data))
        keys, numbers = np.broadcast_to(keys, (*shape, 2)), [np.broadcast_to(x, shape) for x in data]
        found = [
            self.evaluate(traced.jaxpr, traced.consts, [keys[at], *(np.asarray(x[at]) for x in numbers)])[0]
            for at in np.ndindex(shape)
        ]
        aval = _of_words(eqn.outvars[0].aval)
        return np.stack(_alike(found)).reshape(aval.shape)

    def _erf_inv(self, eqn: Any, x: np.ndarray) -> np.ndarray:
        aval = eqn.invars[0].aval
        if aval.dtype != np.float32:
            raise NotScalar("erf_inv of other numbers than float32")
        # JAX's own for Triton chooses between weakly typed constants, which its lowering makes Booleans.
        traced = jax.make_jaxpr(_erf_inv)(aval)
        return self.evaluate(traced.jaxpr, traced.consts, [x])[0]

    def _in_total_order(self, eqn: Any, x: np.ndarray, y: np.ndarray, compare: Any) -> list[np.ndarray]:
        """Whether numbers come before others, in the order of their bits: -0 below 0, and NaN at the ends."""

        def is_before(x: jax.Array, y: jax.Array) -> jax.Array:
            if jnp.issubdtype(x.dtype, jnp.floating):
                whole = jnp.dtype(f"int{8 * x.dtype.itemsize}")
                bits = (lax.bitcast_convert_type(z, whole) for z in (x, y))
                # Those of a negative number grow as it falls, but for the one of its sign.
                x, y = (jnp.where(z < 0, z ^ jnp.iinfo(whole).max, z) for z in bits)
            return compare(x, y)

        traced = jax.make_jaxpr(is_before)(*(v.aval for v in eqn.invars))
        return self.evaluate(traced.jaxpr, traced.consts, [x, y])

    _le_to = functools.partialmethod(_in_total_order, compare=lax.le)
    _lt_to = functools.partialmethod(_in_total_order, compare=lax.lt)

    def _threefry2x32(self, eqn: Any, *arrays: np.ndarray) -> list[np.ndarray]:
        def words(k0: jax.Array, k1: jax.Array, x0: jax.Array, x1: jax.Array) -> Any:
            return threefry(jnp.stack([k0, k1]), x0, x1, num_rounds=20)

        traced = jax.make_jaxpr(words)(*(v.aval for v in eqn.invars))
        return self.evaluate(traced.jaxpr, traced.consts, arrays)

    def _split(self, eqn: Any, x: np.ndarray) -> list[np.ndarray]:
        return np.split(x, np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"])

    def _pad(self, eqn: Any, x: np.ndarray, value: np.ndarray) -> np.ndarray:
        config, aval = eqn.params["padding_config"], eqn.outvars[0].aval
        if min(min(low, high) for low, high, _ in config) < 0:
            raise NotScalar("a negative pad")
        found = _objects(np.broadcast_to(value, aval.shape))
        # Element k of x stands at low + k (1 + gap) of its axis.
        ends = (low + (size - 1) * (1 + gap) + 1 for (low, _, gap), size in zip(config, x.shape, strict=True))
        places = zip(config, ends, strict=True)
        found[tuple(slice(low, end, 1 + gap) for (low, _, gap), end in places)] = _objects(x)
        return _tidy(found, aval.dtype)

    def _unstack(self, eqn: Any, x: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(part) for part in np.moveaxis(x, eqn.params["axis"], 0)]

    def _reduced(self, eqn: Any, x: np.ndarray, name: str, empty: Callable[[Any], Any]) -> np.ndarray:
        dtype, axes = eqn.outvars[0].aval.dtype, tuple(eqn.params["axes"])
        rest = [i for i in range(x.ndim) if i not in axes]
        size = math.prod(x.shape[i] for i in axes)
        x = x.transpose(*rest, *axes).reshape(*(x.shape[i] for i in rest), size)
        found = np.empty(x.shape[:-1], object)
        for at in np.ndindex(found.shape):
            found[at] = self.total(name, list(x[at]) or [np.dtype(dtype).type(empty(dtype))], dtype)
        return _tidy(found, dtype)

    _reduce_sum = functools.partialmethod(_reduced, name="add", empty=lambda dtype: 0)
    _reduce_max = functools.partialmethod(_reduced, name="max", empty=lambda dtype: _bounds(dtype)[0])
    _reduce_min = functools.partialmethod(_reduced, name="min", empty=lambda dtype: _bounds(dtype)[1])
    _reduce_and = functools.partialmethod(_reduced, name="and", empty=lambda dtype: True)
    _reduce_or = functools.partialmethod(_reduced, name="or", empty=lambda dtype: False)

    def _dot_general(self, eqn: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        aval, ((lc, rc), (lb, rb)) = eqn.outvars[0].aval, eqn.params["dimension_numbers"]
        for factor in (v.aval.dtype for v in eqn.invars):
            is_cut = jnp.issubdtype(factor, jnp.floating) and not jnp.issubdtype(aval.dtype, jnp.floating)
            if is_cut or factor.itemsize > aval.dtype.itemsize:
                raise NotScalar("a product of a narrower type than its factors")
        x, y = (self.converted(array, np.dtype(aval.dtype)) for array in (x, y))

        def matrices(x: np.ndarray, batch: Sequence[int], summed: Sequence[int]) -> np.ndarray:
            rest = [i for i in range(x.ndim) if i not in (*batch, *summed)]
            sizes = [math.prod(x.shape[i] for i in axes) for axes in (batch, rest, summed)]
            return x.transpose(*batch, *rest, *summed).reshape(sizes)

        # Any contraction is a batch of products x y' of two matrices, rows times summed axes.
        x, y = matrices(x, lb, lc), matrices(y, rb, rc)
        times, found = _operation("mul"), np.empty((len(x), x.shape[1], y.shape[1]), object)
        for k, i, j in np.ndindex(found.shape):
            pairs = zip(x[k, i], y[k, j], strict=True)
            products = [self.apply("mul", times, pair, aval.dtype) for pair in pairs]
            # Most entries of a robot's matrices are known zeros; the sum has the others only.
            products = [p for p in products if isinstance(p, Scalar) or p != 0]
            found[k, i, j] = self.total("add", products or [aval.dtype.type(0)], aval.dtype)
        return _tidy(found, aval.dtype).reshape(aval.shape)

    def _cholesky(self, eqn: Any, a: np.ndarray) -> np.ndarray:
        if a.ndim != 2:
            raise NotScalar("a batch of matrices")
        factor = _objects(np.zeros(a.shape, eqn.outvars[0].aval.dtype))
        # Column by column, each from its diagonal downwards: row i of column j needs the columns before j.
        for j, i in itertools.combinations_with_replacement(range(len(a)), 2):
            rest = self._less(a[i, j], factor[i, :j], factor[j, :j])
            name, operands = ("sqrt", [rest]) if i == j else ("div", [rest, factor[j, j]])
            factor[i, j] = self.apply(name, _operation(name), operands, rest.dtype)
        return factor

    def _triangular_solve(self, eqn: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        params, divide = eqn.params, _operation("div")
        if not params["left_side"] or params["unit_diagonal"] or a.ndim != 2:
            raise NotScalar("triangular_solve")
        a = a.T if params["transpose_a"] else a
        is_lower = params["lower"] != params["transpose_a"]
        x = _objects(np.zeros(b.shape, eqn.outvars[0].aval.dtype))
        # Forward substitution, or backward from the last row for an upper triangle.
        for i in range(len(a)) if is_lower else reversed(range(len(a))):
            before = slice(i) if is_lower else slice(i + 1, None)
            for j in range(x.shape[1]):
                rest = self._less(b[i, j], a[i, before], x[before, j])
                x[i, j] = self.apply("div", divide, [rest, a[i, i]], rest.dtype)
        return _tidy(x, eqn.outvars[0].aval.dtype)

    def _less(self, start: Any, xs: Iterable[Any], ys: Iterable[Any]) -> Any:
        """A scalar less the product of two rows."""
        for pair in zip(xs, ys, strict=True):
            product = self.apply("mul", _operation("mul"), pair, start.dtype)
            start = self.apply("sub", _operation("sub"), [start, product], start.dtype)
        return start

    def _gather(self, eqn: Any, x: np.ndarray, indices: np.ndarray) -> np.ndarray:
        numbers, aval = eqn.params["dimension_numbers"], eqn.outvars[0].aval
        at = _windows(
            x.shape,
            indices,
            eqn.params["slice_sizes"],
            numbers.start_index_map,
            numbers.collapsed_slice_dims,
            (numbers.operand_batching_dims, numbers.start_indices_batching_dims),
            eqn.params["mode"] == GatherScatterMode.FILL_OR_DROP,
        )
        fill = eqn.params["fill_value"]
        if fill is None:
            low, high = _bounds(aval.dtype)
            is_signed = np.issubdtype(aval.dtype, np.signedinteger)
            fill = np.nan if np.issubdtype(aval.dtype, np.floating) else low if is_signed else high
        # The fill value is appended: windows outside of the array have index -1, which is the last element.
        found = np.append(_objects(x).reshape(-1), np.dtype(aval.dtype).type(fill))[at]
        first = indices.ndim - 1
        found = np.moveaxis(found, range(first, found.ndim), numbers.offset_dims)
        return _tidy(found, aval.dtype)

    def _scatter(self, eqn: Any, x: np.ndarray, indices: np.ndarray, updates: np.ndarray, name="") -> Any:
        numbers, aval, combine = (
            eqn.params["dimension_numbers"],
            eqn.outvars[0].aval,
            eqn.params["update_jaxpr"],
        )
        if not name and combine is not None and combine.outvars[0] is not combine.invars[1]:
            raise NotScalar("a scatter by a function")
        windows, first = numbers.update_window_dims, indices.ndim - 1
        updates = np.moveaxis(updates, windows, range(first, updates.ndim))
        dropped = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        sizes = iter(updates.shape[first:])
        at = _windows(
            x.shape,
            indices,
            [1 if i in dropped else next(sizes) for i in range(x.ndim)],
            numbers.scatter_dims_to_operand_dims,
            numbers.inserted_window_dims,
            (numbers.operand_batching_dims, numbers.scatter_indices_batching_dims),
            eqn.params["mode"] != GatherScatterMode.CLIP,
        )
        # One element more than x takes the updates outside of it, at index -1, and is dropped.
        found = np.append(_objects(x).reshape(-1), aval.dtype.type(0))
        for i, update in zip(at.reshape(-1), updates.reshape(-1), strict=True):
            found[i] = self.apply(name, _operation(name), [found[i], update], aval.dtype) if name else update
        return _tidy(found[:-1].reshape(x.shape), aval.dtype)

    _scatter_add = functools.partialmethod(_scatter, name="add")
    _scatter_mul = functools.partialmethod(_scatter, name="mul")

    # ---- loops

    def _while(self, eqn: Any, *arrays: np.ndarray) -> list[np.ndarray]:
        params = eqn.params
        first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        avals = [v.aval for v in eqn.outvars]
        # Body and condition are taken apart once for all steps: nothing is known about the carry, even where
        # the loop starts with known numbers.
        self._level += 1
        carry = [self.inputs(aval) for aval in avals]
        (go_on,) = self.evaluate(*_opened(params["cond_jaxpr"]), [*arrays[:first], *carry])
        if go_on.ndim:
            raise NotScalar("a loop with a condition for each lane")
        after = self.evaluate(*_opened(params["body_jaxpr"]), [*arrays[first:second], *carry])
        return self._loop(_elements(carry), _elements(after, avals), go_on[()], arrays[second:], avals)

    def _scan(self, eqn: Any, *arrays: np.ndarray) -> list[np.ndarray]:
        jaxpr, consts = _opened(eqn.params["jaxpr"])
        avals, length = [v.aval for v in eqn.outvars], eqn.params["length"]
        shapes = [v.aval.shape for v in jaxpr.outvars]
        # Constants, then the carry, then what is scanned over, which has one more axis.
        end = sum(np.ndim(x) == len(v.aval.shape) for x, v in zip(arrays, jaxpr.invars, strict=True))
        first = end - sum(len(shape) == aval.ndim for shape, aval in zip(shapes, avals, strict=True))
        if length == 0:
            empty = [np.zeros(aval.shape, aval.dtype) for aval in avals[end - first :]]
            return [*arrays[first:end], *empty]
        if eqn.params["reverse"] or end - first < len(avals):
            raise NotScalar("a scan with results of every step, or backwards")
        # A scan becomes a while loop that counts its steps; the scans of MJX have few.
        integer = jax.ShapeDtypeStruct((), np.dtype(np.int32))
        self._level += 1
        step, carry, now = self.inputs(integer), [self.inputs(aval) for aval in avals], []
        for x, v in zip(arrays[end:], jaxpr.invars[end:], strict=True):
            now.append(self.chosen(step, [np.asarray(each) for each in x], v.aval.dtype))
        after = self.evaluate(jaxpr, consts, [*arrays[:first], *carry, *now])
        go_on = self.elementwise("lt", [step, np.asarray(length, np.int32)], bool)
        following = self.elementwise("add", [step, np.asarray(1, np.int32)], np.int32)
        inputs, after = [step[()], *_elements(carry)], [following[()], *_elements(after, avals)]
        start = [np.asarray(0, np.int32), *arrays[first:end]]
        return self._loop(inputs, after, go_on[()], start, [integer, *avals])[1:]

    def _loop(self, carry: Any, after: Any, go_on: Any, start: Any, avals: Any) -> list[np.ndarray]:
        level, self._level = self._level, self._level - 1
        # What the loop reads from around it: the search stops at scalars of a lower level, which are computed
        # outside, and enter the loop as values that its functions close over.
        free = _reachable([*after, go_on], carry, stop=lambda x: x.level < level)
        free = [x for x in free if x.level < level]
        starts = _elements(start, avals)

        def compute(*values: jax.Array) -> tuple[jax.Array, ...]:
            around = dict(zip(free, values[len(starts) :], strict=True))

            def inside(state: Sequence[jax.Array]) -> dict[Scalar, jax.Array]:
                return around | dict(zip(carry, state, strict=True))

            def one_more(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
                return tuple(_computed(after, inside(state)))

            return lax.while_loop(
                lambda state: _computed([go_on], inside(state))[0], one_more, values[: len(starts)]
            )

        # The loop is one scalar, whose value is the tuple of the final carry; the results are its elements.
        # Its own dtype is never read.
        whole = self.scalar([*starts, *free], compute, np.float32)
        index = itertools.count()

        def result(aval: Any) -> np.ndarray:
            def one(_: Any) -> Scalar:
                return self.scalar([whole], operator.itemgetter(next(index)), aval.dtype)

            return _each(one, np.empty(aval.shape))

        return [result(aval) for aval in avals]


_CHAIN = 8
"""Number of terms that are added one after the other, where sums are fused with products."""


_ERF_INV_COEFFICIENTS = np.asarray(
    [
        (2.81022636e-08, -0.000200214257),
        (3.43273939e-07, 0.000100950558),
        (-3.5233877e-06, 0.00134934322),
        (-4.39150654e-06, -0.00367342844),
        (0.00021858087, 0.00573950773),
        (-0.00125372503, -0.0076224613),
        (-0.00417768164, 0.00943887047),
        (0.246640727, 1.00167406),
        (1.50140941, 2.83297682),
    ],
    np.float32,
)
"""Coefficients of `_erf_inv` in the middle and in the tails, from that of the highest power."""


def _erf_inv(x: jax.Array) -> jax.Array:
    """The inverse error function of Giles (GPU Computing Gems 2, 2011), as XLA computes it in 32 bits."""
    w = -jnp.log1p(-x * x)
    is_middle = w < 5.0
    w = jnp.where(is_middle, w - 2.5, jnp.sqrt(w) - 3.0)
    found = jnp.zeros_like(x)
    for middle, tail in _ERF_INV_COEFFICIENTS:
        found = found * w + jnp.where(is_middle, middle, tail)
    return jnp.where(jnp.abs(x) == 1.0, x * jnp.float32(jnp.inf), found * x)


def _or_nan(compute: Callable[..., Any], x: Any, y: Any) -> Any:
    """The result of an operation on two floats, or NaN if one is NaN; Triton's maximum is the other one."""
    return lax.select((x < y) | (x >= y), compute(x, y), x + y)


def _selected(which: Any, *cases: Any) -> Any:
    """The case of a known number; one that is out of range is the first or the last."""
    return cases[min(max(int(which), 0), len(cases) - 1)]


def _simplified(name: str, operands: Sequence[Any], dtype: Any) -> Any:
    """The result of an operation with a known operand, if it is that operand or the other; else None."""
    if name == "select_n":
        which, *cases = operands
        if not isinstance(which, Scalar):
            return _selected(which, *cases)
        is_known = not any(isinstance(x, Scalar) for x in cases)
        # As bytes, since 0 and -0 differ.
        are_equal = (x is cases[0] or (is_known and x.tobytes() == cases[0].tobytes()) for x in cases)
        return cases[0] if all(are_equal) else None
    if len(operands) != 2:
        return None
    if name.startswith("shift"):
        # Of a shift by all bits or more, JAX has 0, and Triton any number.
        if isinstance(operands[1], Scalar):
            raise NotScalar("a shift by a computed number")
        # A negative number of bits is a large unsigned one.
        is_part = 0 <= operands[1] < 8 * np.dtype(dtype).itemsize
        return None if is_part else np.dtype(dtype).type(0)
    for known, other, is_second in ((operands[0], operands[1], False), (operands[1], operands[0], True)):
        if isinstance(known, Scalar):
            continue
        if (name == "add" or (name == "sub" and is_second)) and known == 0:
            return other
        # Not so in IEEE arithmetic if the other is infinite or NaN, or negative: see the module's deviations.
        if name == "mul" and known == 0:
            return np.dtype(dtype).type(0)
        if (name == "mul" or (name == "div" and is_second)) and known == 1:
            return other
        if (name == "max" and known == -np.inf) or (name == "min" and known == np.inf):
            return other
        if name in ("and", "or") and np.dtype(dtype) == np.bool_:
            return other if bool(known) == (name == "and") else known
        if name == "pow" and is_second and known == 1:
            return other
    return None


def _operation(name: str) -> Callable[..., Any]:
    """An elementwise operation of JAX, in primitives that kernels support."""
    if name == "is_finite":
        return lambda x: lax.abs(x) < jnp.asarray(np.inf, x.dtype)
    if name == "sign":
        return lambda x: jnp.where(x > 0, 1, jnp.where(x < 0, -1, x)).astype(x.dtype)
    if name == "square":
        return lambda x: lax.mul(x, x)
    names = {"and": "bitwise_and", "or": "bitwise_or", "xor": "bitwise_xor", "not": "bitwise_not"}
    return getattr(lax, names.get(name, name))


_MOVES: dict[str, Callable[..., np.ndarray]] = {
    **dict.fromkeys(("copy", "copy_p", "stop_gradient"), lambda params, aval, x: x),
    "reshape": lambda params, aval, x: x.transpose(params["dimensions"] or range(x.ndim)).reshape(aval.shape),
    **dict.fromkeys(("squeeze", "expand_dims"), lambda params, aval, x: x.reshape(aval.shape)),
    "broadcast_in_dim": lambda params, aval, x: np.broadcast_to(
        np.expand_dims(x, sorted({*range(aval.ndim)} - {*params["broadcast_dimensions"]})), aval.shape
    ),
    "transpose": lambda params, aval, x: x.transpose(params["permutation"]),
    "slice": lambda params, aval, x: x[
        tuple(map(slice, params["start_indices"], params["limit_indices"], params["strides"] or [1] * x.ndim))
    ],
    "rev": lambda params, aval, x: np.flip(x, params["dimensions"]),
    "concatenate": lambda params, aval, *xs: np.concatenate(_alike(xs), params["dimension"]),
    "stack": lambda params, aval, *xs: np.stack(_alike(xs), params["axis"]),
    "tile": lambda params, aval, x: np.tile(x, params["reps"]),
}
"""Operations that only move elements; they get the parameters, the shape of the result, and the operands."""


_OF_KNOWN: dict[str, Callable[..., Iterable[np.ndarray]]] = {
    "iota": lambda params, aval: [np.indices(aval.shape, aval.dtype)[params["dimension"]]],
    "empty": lambda params, aval: [np.zeros(aval.shape, aval.dtype)],
    "sort": lambda params, aval, *xs: [
        x[np.argsort(_only(params["num_keys"] == x.ndim == 1, xs[0]), kind="stable")] for x in xs
    ],
}
"""Operations on known numbers only, in the forms that MJX uses."""


def _only(is_known: bool, x: np.ndarray) -> np.ndarray:
    if not is_known:
        raise NotScalar("a sort")
    return x


def _bounds(dtype: np.dtype) -> tuple[Any, Any]:
    """The smallest and the largest number of a type."""
    if dtype == np.bool_:
        return False, True
    if np.issubdtype(dtype, np.integer):
        return np.iinfo(dtype).min, np.iinfo(dtype).max
    return -np.inf, np.inf


def _of_words(aval: Any) -> Any:
    """What is known of an array, or of the words of one of keys."""
    return jax.ShapeDtypeStruct((*aval.shape, 2), np.dtype(np.uint32)) if is_key(aval) else aval


def _opened(traced: Any) -> tuple[Any, Sequence[Any]]:
    """A traced function and its constants."""
    return (traced.jaxpr, traced.consts) if hasattr(traced, "jaxpr") else (traced, ())


def _objects(x: np.ndarray) -> np.ndarray:
    """A copy with NumPy's scalars or those of the program as elements."""
    return _each(lambda e: e, x)


def _each(function: Callable[..., Any], *arrays: np.ndarray) -> np.ndarray:
    """The array of what a function returns for the elements of arrays."""
    arrays = np.broadcast_arrays(*arrays)
    found = np.empty(arrays[0].shape, object)
    for at in np.ndindex(found.shape):
        found[at] = function(*(x[at] for x in arrays))
    return found


def _alike(arrays: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
    return [_objects(x) for x in arrays] if any(x.dtype == object for x in arrays) else arrays


def _tidy(x: np.ndarray, dtype: Any) -> np.ndarray:
    """An array of NumPy's, if all elements are known."""
    return x if any(isinstance(e, Scalar) for e in x.reshape(-1)) else x.astype(dtype)


def _elements(arrays: Iterable[np.ndarray], avals: Sequence[Any] | None = None) -> list[Any]:
    """All elements, known ones with the dtypes of `avals`."""
    if avals is None:
        return [e for x in arrays for e in x.reshape(-1)]
    pairs = zip(arrays, avals, strict=True)
    return [e if isinstance(e, Scalar) else a.dtype.type(e) for x, a in pairs for e in x.reshape(-1)]


def _windows(
    shape: Sequence[Any],
    indices: np.ndarray,
    sizes: Sequence[Any],
    index_map: Sequence[Any],
    dropped: Sequence[Any],
    batching: tuple[Sequence[Any], Sequence[Any]],
    drops: bool,
) -> np.ndarray:
    """Flat indices of the windows of a gather or a scatter.

    Windows that are not within the array are moved into it; if `drops`, their indices are -1.
    """
    if indices.dtype == object:
        raise NotScalar("indices that are computed")
    # A gather of the elements' own flat indices tells which element each place of a window is.
    numbers, widths = np.arange(math.prod(shape)).reshape(shape), np.asarray(sizes)
    last = np.asarray(shape) - widths
    kept = sorted({*range(len(shape))} - {*dropped, *batching[0]})
    found = np.empty((*indices.shape[:-1], *(sizes[i] for i in kept)), int)
    for at in np.ndindex(indices.shape[:-1]):
        start = np.zeros(len(shape), int)
        start[list(index_map)] = indices[at]
        start[list(batching[0])] = [at[i] for i in batching[1]]
        inside = np.clip(start, 0, last)
        is_lost = drops and (inside != start).any()
        window = numbers[tuple(map(slice, inside, inside + widths))].reshape([sizes[i] for i in kept])
        found[at] = -1 if is_lost else window
    return found


def _reachable(roots: Iterable[Any], known: Iterable[Scalar], stop: Any = lambda x: False) -> list[Scalar]:
    """Scalars that the roots are computed from, in the order of their computation, without known ones."""
    found, waiting, known = set(), list(roots), set(known)
    while waiting:
        x = waiting.pop()
        if isinstance(x, Scalar) and x not in known and x not in found:
            found.add(x)
            if not stop(x):
                waiting += x.operands
    # Operands have smaller numbers, so that this is an order of computation.
    return sorted(found, key=lambda x: x.number)


def _computed(roots: Sequence[Any], values: dict[Scalar, Any]) -> list[jax.Array]:
    """The values of the roots; the scalars between them and those with values get values, too."""
    shape = jnp.shape(next(iter(values.values())))

    def read(x: Any) -> Any:
        return values[x] if isinstance(x, Scalar) else jnp.full(shape, x, x.dtype)

    for x in _reachable(roots, values):
        assert x.compute is not None
        values[x] = x.compute(*map(read, x.operands))
    return [read(x) for x in roots]
