"""Trial calls of a user's class before anything runs: most are only traced by JAX, and compute nothing."""

import contextlib
import functools
import inspect
import random
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array

from bojax.results.schema import Column
from bojax.text import error_at_line, place_of

T = TypeVar("T")


def trial(part: Any, check: Callable[..., None], *arguments: Any) -> None:
    """Trace a check of a part, unless its class belongs to bojax.

    `check` calls the methods of the part, and `require` with what they return. JAX caches the trace of a
    module-level function, which parts share if they differ only in numbers.

    Raises:
        ValueError: A method raises an exception, or returns something that does not fit.
    """
    if is_users(part):
        with trial_of(type(part).__name__):
            jax.eval_shape(_watched(check), part, *arguments)


def is_users(part: Any) -> bool:
    """Whether the class of a part is a user's, not one of bojax."""
    return not type(part).__module__.startswith("bojax.")


def check_names(cls: type, base: type, overridable: Collection[str]) -> None:
    """Raise a TypeError if a user's class gives another meaning to a method or property of its base class.

    A helper that has the name of a method by chance would be called in its place. Classes of bojax pass.
    Whether what defines an overridable name fits is checked elsewhere.
    """
    names = () if cls.__module__.startswith("bojax.") else (*vars(cls), *vars(cls).get("__annotations__", ()))
    for name in dict.fromkeys(names):
        theirs, given = getattr(base, name, None), vars(cls).get(name)
        if (
            name in overridable
            or name.startswith("__")
            or not (callable(theirs) or isinstance(theirs, property))
        ):
            continue
        if isinstance(theirs, property):
            fits, has = isinstance(given, property), f"the property {name}"
        else:
            expected = list(inspect.signature(theirs).parameters)
            fits = callable(given) and list(inspect.signature(given).parameters) == expected
            has = f"{name}({', '.join(expected)})"
        if not fits:
            theirs_name = f"bojax's {base.__name__} has {has}"
            raise TypeError(f"{cls.__name__}.{name}: {theirs_name}; allowed: the same, or another name")


def computed(function: Callable[..., Any], *parts: Any) -> Any:
    """What a function of parts and a key returns, as NumPy arrays, or a `Misfit` if it is not pure.

    It is a module-level function, so that its program is kept; the arrays of the parts are known.
    """
    require_equal_traces(function, *parts)
    _, program, structure = _traced(function, *shapes(parts))
    arrays = [x for x in jax.tree.leaves(parts) if hasattr(x, "shape")]
    found = [[np.asarray(x) for x in program(*arrays, jax.random.key(1))] for _ in range(2)]
    if not all(np.array_equal(*two, equal_nan=True) for two in zip(*found, strict=True)):
        raise Misfit(_IMPURE)
    return jax.tree.unflatten(structure, found[0])


_IMPURE = "not pure: two calls with equal arguments differ; allowed: random numbers of the key alone"


def require_equal_traces(function: Callable[..., Any], *parts: Any) -> None:
    """Raise a `Misfit` if two traces of a module-level function of parts and a key are not one program."""
    if not _traced(function, *shapes(parts))[0]:
        raise Misfit(_IMPURE)


@functools.lru_cache
def _traced(function: Callable[..., Any], *parts: Any) -> tuple[bool, Callable[..., Any], Any]:
    """Whether two traces are the same program, the program, and the structure of what it returns.

    A number from Python's generators is a constant of a program. The arrays of `parts` are given by their
    shapes, so that points of a sweep share the traces.
    """
    traces = [eqx.filter_make_jaxpr(function)(*parts, jax.random.key(1)) for _ in range(2)]
    first, second = (
        (re.sub(r"0x[0-9a-f]+", "", str(program)), [np.asarray(x).tobytes() for x in program.consts])
        for program, *_ in traces
    )
    program, returned, _ = traces[0]
    return first == second, jax.jit(jaxpr_as_fun(program)), jax.tree.structure(returned)


@functools.cache
def _watched(check: Callable[..., None]) -> Callable[..., None]:
    """The check, which also refuses random numbers of the host: a trace would repeat them in every call."""

    def watched(*arguments: Any) -> None:
        python, numpy = random.getstate(), _numpy_state()
        check(*arguments)
        # Beartype draws from Python's generator whenever it checks a list.
        has_drawn = random.getstate() != python and "beartype" not in sys.modules
        if has_drawn or _numpy_state() != numpy:
            raise Misfit(
                "draws from numpy.random or random, once for all steps and runs; allowed: jax.random with "
                "the given key"
            )

    return watched


def _numpy_state() -> tuple[Any, ...]:
    """The state of NumPy's global generator."""
    _, words, *rest = np.random.get_state(legacy=True)
    return np.asarray(words).tobytes(), *rest


def require_arrays(part: Any) -> None:
    """Raise a ValueError if a field of a module is a Python number, which has no precision."""
    for path, leaf in jax.tree.leaves_with_path(part):
        if isinstance(leaf, int | float):
            where = f"{type(part).__name__}{jax.tree_util.keystr(path)}"
            raise ValueError(
                f"{where} is a {type(leaf).__name__}; allowed: an array, as jnp.asarray({leaf!r})"
            )


_TRACED = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)


@contextlib.contextmanager
def trial_of(name: str) -> Iterator[None]:
    """Raise what goes wrong in a trial call of a user's class as a ValueError of one line."""
    try:
        yield
    except Misfit as error:
        raise ValueError(f"{name}: {error}") from error
    except _TRACED as error:  # its message is long, and about JAX
        raise ValueError(
            f"{name}: a trial call failed: a value that JAX traces is used in an if, a while, as a number or "
            f"by NumPy; allowed: jnp.where, jax.lax.cond or jax.numpy ({place_of(error)})"
        ) from error
    except (Exception, SystemExit) as error:  # a user's class may raise anything
        raise ValueError(f"{name}: a trial call failed: {error_at_line(error)}") from error


def require(name: str, value: Any, expected: Array) -> None:
    """Raise a `Misfit` unless a value is an array of the shape and the precision of another one."""
    if isinstance(value, Array) and (value.shape, value.dtype) == (expected.shape, expected.dtype):
        return
    is_precision = jnp.issubdtype(expected.dtype, jnp.floating) and (
        value.shape == expected.shape if isinstance(value, Array) else isinstance(value, int | float)
    )
    hint = "; use the dtype of a field, as in jnp.asarray(x, self.FIELD.dtype)" if is_precision else ""
    if isinstance(value, bool) and expected.dtype == bool:
        hint = "; use jnp.asarray(x)"
    raise Misfit(f"{name} is {described(value)}; allowed: {expected.dtype} of shape {expected.shape}{hint}")


def require_columns(method: str, values: Any, attribute: str, columns: Any) -> None:
    """Raise a `Misfit` unless a method returns one number for each column that an attribute declares."""
    if not (isinstance(columns, tuple) and all(isinstance(each, Column) for each in columns)):
        raise Misfit(f"{attribute} is {columns!r:.60}; allowed: a tuple of bojax.results.schema.Column")
    dtypes = {each.name: "int32" if each.words else each.dtype for each in columns}
    if not isinstance(values, Mapping) or values.keys() != dtypes.keys():
        found = list(values) if isinstance(values, Mapping) else described(values)
        raise Misfit(f"{method} returns {found}; allowed: the names of {attribute}, {list(dtypes)}")
    for name, value in values.items():
        fits = isinstance(value, Array) and value.shape == ()
        if not (fits and np.can_cast(value.dtype, dtypes[name], "same_kind")):
            raise Misfit(f"{name} of {method} is {described(value)}; allowed: {dtypes[name]} of shape ()")


def require_state(method: str, after: Any, before: Any) -> None:
    """Raise a `Misfit` unless a method returns a state with the arrays of an earlier one."""
    if jax.tree.structure(after) != jax.tree.structure(before):
        raise Misfit(f"the state of {method} differs in structure from the first")
    for (path, leaf), other in zip(jax.tree.leaves_with_path(before), jax.tree.leaves(after), strict=True):
        require(f"state{jax.tree_util.keystr(path)} of {method}", other, jnp.asarray(leaf))


def described(value: Any) -> str:
    """The precision and the shape of an array, or the type of another value."""
    return f"{value.dtype} of shape {value.shape}" if isinstance(value, Array) else type(value).__name__


def shapes(part: T) -> T:
    """A part with the shapes and precisions of its arrays in their place: a key of caches of traces."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype) if hasattr(x, "shape") else x, part)


class Misfit(Exception):
    """What a method returned, and what would fit."""
