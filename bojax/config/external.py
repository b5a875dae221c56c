"""Parts given by import path: the user's class is imported, and a schema class is made of its settings.

Its settings are the fields of a nested pydantic class `Config`, or else the annotated arguments of the
constructor. After validation, an imported part is a component like any other.
"""

import dataclasses
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from functools import cache, partial
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import pydantic

from bojax.config.catalog import roles
from bojax.config.component import Component, External, import_target
from bojax.config.errors import ConfigError, Location, did_you_mean, dotted, from_validation, shown
from bojax.config.files import WRITTEN, display
from bojax.config.points import Sweep
from bojax.config.signature import fields_of
from bojax.text import error_at_line

Locate = Callable[[Location], str]


def imports_code(sweep: Sweep) -> bool:
    """Whether any part of the sweep imports a module outside bojax."""
    return any(_imports_code(point.config) for point in sweep.points)


def resolve(sweep: Sweep) -> Sweep:
    """The sweep with every import path imported and the settings validated; this runs the user's code.

    A module that a file of a results folder names is printed before it is imported.
    """
    here = str(Path.cwd())
    if here not in sys.path:  # the installed command `bojax` leaves it out
        sys.path.insert(0, here)
    points = []
    for point in sweep.points:
        config = _resolve(point.config, (), partial(sweep.locate, point.index))
        variant = config.label if point.variant == point.label else point.variant
        points.append(dataclasses.replace(point, config=config, label=config.label, variant=variant))
    return dataclasses.replace(sweep, points=tuple(points))


def resolved_in(component: Component, file: Path) -> Component:
    """The settings of a file of a results folder, with every import path imported as by `resolve`."""
    return _resolve(component, (), lambda location: f"{display(file)}: {dotted(location)}")


def _imports_code(component: Component) -> bool:
    parts = (getattr(component, name) for name in type(component).model_fields)
    nested = (part for part in parts if isinstance(part, Component))
    return component.imported_module is not None or any(map(_imports_code, nested))


def _resolve(component: Component, path: Location, locate: Locate) -> Component:
    if component.imported_module is not None:
        module, setting = component.imported_module
        _announce(module, locate((*path, setting)))
    if isinstance(component, External):
        component = _validate(component, path, locate)
    changes = {}
    for name in type(component).model_fields:
        value = getattr(component, name)
        if isinstance(value, Component):
            resolved = _resolve(value, (*path, name), locate)
            if resolved is not value:
                changes[name] = resolved
    return component.model_copy(update=changes) if changes else component


@cache
def _announce(module: str, place: str) -> None:
    """Print the name of a module before its import if a results folder names it.

    The config may come from somebody else, and importing the module runs its code.
    """
    root, *below = module.split(".")
    if Path(place.rpartition(": ")[0]).name not in WRITTEN or not root.isidentifier():
        return
    loaded = sys.modules.get(root)
    spec = importlib.util.find_spec(root) if loaded is None else getattr(loaded, "__spec__", None)
    if spec is None:  # the import reports the missing module
        return
    for name in below:  # importlib.util.find_spec would import the parent packages
        inner = PathFinder.find_spec(f"{spec.name}.{name}", spec.submodule_search_locations or [])
        if inner is None:
            break
        spec = inner
    print(f"importing {module} ({spec.origin}), named in {place}", file=sys.stderr)


def _validate(external: External, path: Location, locate: Locate) -> Component:
    where = (*path, "kind") if path else ()
    try:
        schema = _schema_of(external.slot, external.kind, _import(external.kind))
        return schema.model_validate({"kind": external.kind, **external.params})
    except _Refusal as error:
        raise ConfigError(f"{locate(where)}: {error}") from error.__cause__
    except pydantic.ValidationError as error:
        refused = from_validation(error, lambda location: locate((*path, *location)))
        if not external.params:
            refused = ConfigError(f"{refused}; a new kind discards the settings of the old one")
        raise refused from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # raised by the user's annotations or validators
        got = f"{locate(where)}: got {shown(external.kind)}"
        raise ConfigError(f"{got}; checking its settings failed: {error_at_line(error)}") from error


class _Refusal(Exception):
    """The reason why a class cannot be used."""


@cache
def _schema_of(role: str, kind: str, cls: type) -> type[Component]:
    """The schema class of the class that the import path names now: a notebook may define it again."""
    _check_protocol(cls, role, kind)
    config = getattr(cls, "Config", None)
    if isinstance(config, type) and issubclass(config, pydantic.BaseModel):
        fields, left_out = {}, frozenset()
        bases = (config, Component)
    else:
        bases = (Component,)
        try:
            fields, left_out = fields_of(cls)
        except TypeError as error:
            raise _Refusal(f"got {shown(kind)}; {error}") from error
    create: Any = pydantic.create_model  # its overloads exclude fields made at run time
    schema = create(cls.__name__, __base__=bases, __module__=cls.__module__, **fields)
    schema.__doc__ = inspect.getdoc(cls)
    schema.role, schema.target, schema.constructor_defaults = role, kind, left_out
    return schema


def _import(kind: str) -> type:
    module_name, _, name = kind.partition(":")
    got = f"got {shown(kind)}; "
    try:
        module = importlib.import_module(module_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a script may call sys.exit
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and f"{module_name}.".startswith(f"{missing}."):
            raise _Refusal(
                f"{got}module {missing} is neither in the working directory ({Path.cwd()}) nor installed"
            ) from error
        raise _Refusal(f"{got}importing {module_name} failed: {error_at_line(error)}") from error
    if not hasattr(module, name):
        names = [key for key, value in vars(module).items() if isinstance(value, type)]
        raise _Refusal(f"{got}{module_name} has no {name}{did_you_mean(name, names)}")
    cls = getattr(module, name)
    if not isinstance(cls, type):
        raise _Refusal(f"{got}{name} is not a class")
    return cls


def _check_protocol(cls: type, role: str, kind: str) -> None:
    """Refuse a class that lacks abstract methods or fields of the base class of its role."""
    missing = {*getattr(cls, "__abstractmethods__", ()), *getattr(cls, "__abstractvars__", ())}
    base = roles()[role].protocol
    if base:
        protocol: Any = import_target(base)
        missing |= protocol.__abstractmethods__ - {name for parent in cls.__mro__ for name in vars(parent)}
    if missing:
        names = sorted(missing)
        # The class that declares a name describes it; one that only has its methods has no such base.
        owners = (each for each in cls.__mro__ if names[0] in vars(each) | inspect.get_annotations(each))
        owner = next(owners, None)
        see = f"{owner.__module__}.{owner.__name__}" if owner else base.replace(":", ".")
        hint = f"; see {see}" if see else ""
        if any(parent.__module__.startswith("gymnasium.") for parent in cls.__mro__):
            hint = "; a class of Gymnasium is registered there, and given by kind=gymnasium id=MODULE:ID"
        raise _Refusal(f"got {shown(kind)}; the class does not implement {', '.join(names)}{hint}")
