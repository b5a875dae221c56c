"""The fields of a schema class, read from the annotations of a constructor.

Array types are recognised by name, so that this module imports no array library.
"""

import dataclasses
import inspect
import math
import types
from typing import Annotated, Any, Literal, Optional, Union, get_args, get_origin, get_type_hints

from pydantic import Field, PlainValidator


def _numbers(value: Any) -> Any:
    if isinstance(value, list | tuple):
        items = tuple(_numbers(item) for item in value)
        if len({_shape(item) for item in items}) > 1:
            raise ValueError("allowed: lists of equal lengths")
        return items
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError("allowed: a number or a list of numbers")
    return value


def _shape(value: Any) -> tuple[int, ...]:
    """The shape of nested tuples; the items of each have equal shapes."""
    return (len(value), *_shape(value[0])) if isinstance(value, tuple) and value else ()


Numbers = Annotated[Any, PlainValidator(_numbers)]
"""A number, or a list of numbers, or a list of such lists."""

_PLAIN = (int, float, bool, str, type(None))


def fields_of(cls: type) -> tuple[dict[str, tuple[Any, Any]], frozenset[str]]:
    """The fields `{name: (annotation, default)}` of a schema of `cls`.

    Returns:
        The fields, and the names of those that keep the default of the constructor: it is not a plain value.

    Raises:
        TypeError: A required parameter is not annotated as a number, text, a Boolean or an array.
    """
    hints = _hints(cls)
    fields: dict[str, tuple[Any, Any]] = {}
    left_out = set()
    for name, parameter in inspect.signature(cls).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        annotation = _field_type(hints.get(name, parameter.annotation))
        has_default = parameter.default is not parameter.empty
        if annotation is None:
            if not has_default:
                raise TypeError(
                    f"the annotation of {name} in {cls.__name__} is not the type of a setting; allowed: "
                    "numbers, text, Booleans and arrays; parts, such as a field, are declared in a nested "
                    "pydantic class Config"
                )
            continue  # not a setting
        default = parameter.default if has_default else ...
        if has_default and not _is_plain(default):
            left_out.add(name)
            annotation, default = Optional[annotation], None  # noqa: UP045 (made at run time)
        fields[name] = (annotation, default)
    return fields, frozenset(left_out)


def _hints(cls: type) -> dict[str, Any]:
    try:
        if dataclasses.is_dataclass(cls):
            return get_type_hints(cls, include_extras=True)
        return get_type_hints(cls.__init__, include_extras=True)
    except (NameError, TypeError):  # names that only type checkers import
        return {}


def _field_type(annotation: Any) -> Any:
    """The type of the schema field for an annotation; None if a setting cannot have the annotated type."""
    if annotation is inspect.Parameter.empty or annotation is Any:
        return Numbers
    if _is_array(annotation):
        return float if getattr(annotation, "dim_str", None) == "" else Numbers
    origin = get_origin(annotation)
    if annotation in _PLAIN or origin is Literal:
        return annotation
    if origin is Annotated:
        return _field_type(get_args(annotation)[0])
    if origin is tuple:
        items = [item if item is ... else _field_type(item) for item in get_args(annotation)]
        return None if None in items else Annotated[tuple[tuple(items)], Field(strict=False)]
    if origin in (Union, types.UnionType):
        items = [_field_type(item) for item in get_args(annotation)]
        if Numbers in items:
            items = [Numbers, *(item for item in items if item is type(None))]
        return None if None in items else Union[tuple(items)]  # noqa: UP007 (made at run time)
    return None


def _is_array(annotation: Any) -> bool:
    if hasattr(annotation, "dim_str"):  # jaxtyping
        return True
    module = (getattr(annotation, "__module__", None) or "").partition(".")[0]
    name = getattr(annotation, "__name__", "").rpartition(".")[2]
    return module in ("jax", "jaxlib", "numpy") and name in ("Array", "ndarray")


def _is_plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(_is_plain(item) for item in value)
    return isinstance(value, _PLAIN)
