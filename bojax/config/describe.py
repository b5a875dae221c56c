"""Descriptions of schema classes for `bojax list` and the documentation: type, default, meaning."""

import inspect
import types
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pydantic
from pydantic.fields import FieldInfo

from bojax.config.component import Registered, slot_of
from bojax.config.errors import shown


@dataclass(frozen=True)
class Setting:
    """One setting of a part."""

    name: str  # key of the setting
    type: str  # type and bounds
    default: str  # default in YAML notation; empty if the setting is required
    meaning: str  # meaning and unit


def settings_of(schema: type[pydantic.BaseModel]) -> list[Setting]:
    """The settings of a schema class, in the order of its definition."""
    return [
        Setting(field.alias or name, _type(field), _default(field), field.description or "")
        for name, field in schema.model_fields.items()
        if name != "kind"
    ]


def summary_of(schema: type[pydantic.BaseModel]) -> str:
    """The first sentence of a schema class's docstring."""
    return (inspect.getdoc(schema) or "").partition("\n")[0]


_WORDS = {int: "integer", float: "number", str: "text", bool: "true | false", type(None): "null"}
_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _type(field: FieldInfo) -> str:
    if slot := slot_of(field):
        return f"{slot.role} | null" if slot.optional else slot.role
    bounds = [
        f"{sign} {getattr(mark, name):.15g}"
        for name, sign in _SIGNS.items()
        for mark in field.metadata
        if getattr(mark, name, None) is not None
    ]
    words, null = _words(field.annotation), " | null"
    bounded = " ".join([words.removesuffix(null), ", ".join(bounds)]).strip()
    return bounded + null if words.endswith(null) else bounded


def _words(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _words(arguments[0])
    if origin is Literal:
        return " | ".join(str(argument) for argument in arguments)
    if origin in (Union, types.UnionType):
        return " | ".join(_words(argument) for argument in arguments)
    if origin in (tuple, list):
        return f"list of {_words(arguments[0])}" if arguments else "list"
    if origin is dict or (isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel)):
        return "mapping"
    return _WORDS.get(annotation, "any")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    if isinstance(field.default, Registered):
        return field.default.kind
    if isinstance(field.default, pydantic.BaseModel):
        return shown(field.default.model_dump())
    if isinstance(field.default, float):
        return f"{field.default:.6g}"
    return field.default if isinstance(field.default, str) and field.default else shown(field.default)
