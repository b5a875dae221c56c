"""From settings to objects: import a component's class and construct it with strongly typed arrays."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_args

import jax
import jax.numpy as jnp

from bojax.config.component import IMPORT_PATH, Built, Component, External, import_target
from bojax.config.errors import ConfigError, Location, dotted, shown
from bojax.text import error_at_line, one_line

Locate = Callable[[Location], str]

HOW_TO_BUILD = ("dtype", "saved_run")
"""Settings of an experiment that say how it is built; its constructor need not accept them."""


def construct(component: Component, dtype: str, locate: Locate = dotted, path: Location = ()) -> Any:
    """The object that a component describes, whose import paths have been resolved.

    Static fields of a module stay Python values. Every other number or list of numbers becomes an array of
    `dtype`, even if it is an integer, so that it is a leaf that can be swept. Booleans become boolean arrays.
    Strings and null stay as they are.

    `path` leads to the component, and `locate` formats the path of a setting for messages.

    Raises:
        ConfigError: A constructor rejects its settings.
    """
    if isinstance(component, Built):
        return component.value
    if isinstance(component, External):
        raise ConfigError(
            f"{locate(path) or component.slot}: got {component.kind}; allowed: a name, or an object of the "
            "class (import paths are resolved in configs alone)"
        )
    cls = import_target(component.target)
    static = static_fields(cls)
    accepted = inspect.signature(cls).parameters
    arguments = {}
    for name in type(component).model_fields:
        left_out = name in component.constructor_defaults and name not in component.model_fields_set
        is_for_build = name in HOW_TO_BUILD and name not in accepted
        if name == "kind" or left_out or is_for_build:
            continue
        value = getattr(component, name)
        if isinstance(value, Component):
            arguments[name] = construct(value, dtype, locate, (*path, name))
        elif name in static:
            arguments[name] = value
        else:
            arguments[name] = _leaf(value, dtype)
    _check_arguments(arguments, accepted, component, lambda name: locate((*path, name)))
    _check_shapes(arguments, accepted, lambda name: locate((*path, name)))
    try:
        return cls(**arguments)
    except ValueError as error:
        name, _, rest = one_line(error).partition(": ")
        below = name.split(".")
        is_setting = below[0] in type(component).model_fields
        where = locate((*path, *below)) if is_setting else locate(path) or component.kind
        raise ConfigError(f"{where}: {rest if is_setting else one_line(error)}") from error
    except KeyboardInterrupt:
        raise
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        raise ConfigError(
            f"{locate(path) or component.kind}: its arrays cannot be made ({one_line(error)})"
        ) from error
    except BaseException as error:  # a user's class may raise anything
        if not IMPORT_PATH.fullmatch(component.kind):
            raise
        got = f"{locate(path) or component.kind}: got {shown(component.kind)}"
        raise ConfigError(f"{got}; its constructor failed: {error_at_line(error)}") from error


def static_fields(cls: type) -> frozenset[str]:
    """Arguments that stay Python values: static fields, and arguments that are not fields."""
    if not dataclasses.is_dataclass(cls):
        return frozenset(inspect.signature(cls).parameters)
    fields = {field.name: field for field in dataclasses.fields(cls)}
    others = inspect.signature(cls).parameters.keys() - fields.keys()
    return frozenset(name for name, field in fields.items() if field.metadata.get("static")) | others


def _leaf(value: Any, dtype: str) -> Any:
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool):
        return jnp.asarray(value)
    return jnp.asarray(value, dtype)


def _check_arguments(
    arguments: Mapping[str, Any],
    accepted: Mapping[str, inspect.Parameter],
    component: Component,
    locate: Callable[[str], str],
) -> None:
    """Refuse arguments that the constructor does not accept, and required arguments that are missing."""
    kinds = inspect.Parameter
    is_open = any(parameter.kind is kinds.VAR_KEYWORD for parameter in accepted.values())
    for name in arguments:
        if name not in accepted and not is_open:
            raise ConfigError(
                f"{locate(name)}: not an argument of the constructor of "
                f"{component.target}; allowed: {', '.join(accepted) or 'none'}"
            )
    for name, parameter in accepted.items():
        is_needed = parameter.default is kinds.empty and parameter.kind not in (
            kinds.VAR_KEYWORD,
            kinds.VAR_POSITIONAL,
        )
        if is_needed and name not in arguments:
            raise ConfigError(
                f"{locate(name)}: required by the constructor of {component.target}, "
                f"but not a setting of {type(component).__name__}"
            )


def _check_shapes(
    arguments: Mapping[str, Any], accepted: Mapping[str, inspect.Parameter], locate: Callable[[str], str]
) -> None:
    """Refuse an array whose shape differs from its annotation: JAX does not report out-of-bounds indices."""
    for name, value in arguments.items():
        expected: Any = accepted[name].annotation if name in accepted else object
        if not isinstance(value, jax.Array) or expected in (float, int):
            continue
        try:
            fits = isinstance(value, expected)
        except TypeError:  # a string, or another annotation that isinstance does not accept
            continue
        if not fits:
            shape = f"{value.size} numbers" if value.ndim == 1 else f"shape {value.shape}"
            wanted = " or ".join(_dimensions(kind) for kind in get_args(expected) or (expected,))
            raise ConfigError(f"{locate(name)}: got {shape}; allowed: {wanted}")


def _dimensions(annotation: Any) -> str:
    """The shape of an annotation in words, such as "3 numbers" for `Float[Array, "3"]`."""
    dimensions = getattr(annotation, "dim_str", None)
    if dimensions is None:
        return getattr(annotation, "__name__", str(annotation))
    return f"{dimensions.strip()} numbers" if dimensions.strip() else "one number"
