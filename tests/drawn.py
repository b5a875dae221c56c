"""Valid experiments drawn from the schemas: any parts that discovery finds, with small settings."""

import math
import random
import types
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
import pydantic
from pydantic.fields import FieldInfo

from bojax.config.catalog import kinds
from bojax.config.component import Component, Slot, slot_of, slots
from tests.parts import REQUIRED

SMALL = 5
"""Largest amount by which a drawn integer exceeds its lower bound; settings of this size cost no time."""

MOST_ENTRIES = 2
"""Largest amount by which the length of a drawn list exceeds its lower bound."""

_MAX_TRIES = 50


def drawn_experiment(draw: random.Random) -> Component:
    """An experiment with any parts and settings that its schema allows; parts may not fit each other.

    Experiments with more slots are drawn more often: more parts are tried in them.
    """
    schemas = kinds("experiment")
    weights = [len(list(slots(schema))) for schema in schemas.values()]
    return drawn(draw, draw.choices(list(schemas.values()), weights)[0])


def drawn(draw: random.Random, schema: type[Component]) -> Component:
    """A component of a schema; after too many refused draws, the one with the default of every setting."""
    required = REQUIRED.get(schema.model_fields["kind"].default, {})
    for _ in range(_MAX_TRIES):
        settings = {
            name: _setting(draw, field) for name, field in schema.model_fields.items() if name != "kind"
        }
        given = {name: value for name, value in settings.items() if value is not _DEFAULT}
        given |= {name: value for name, value in required.items() if name not in dict(slots(schema))}
        try:
            return schema.model_validate(given)
        except pydantic.ValidationError:
            continue
    return schema.model_validate(required)


_DEFAULT = object()
"""Stands for a setting that keeps its default."""


def _setting(draw: random.Random, field: FieldInfo) -> Any:
    if slot := slot_of(field):
        return _part(draw, slot)
    has_default = not field.is_required()
    value = _value(draw, field.annotation, field.metadata, field.default if has_default else None)
    is_small = not isinstance(field.default, int) or field.default <= SMALL
    return _DEFAULT if has_default and is_small and draw.random() < 0.5 else value


def _part(draw: random.Random, slot: Slot) -> Component | None:
    schemas = [each for each in kinds(slot.role).values() if slot.only is None or issubclass(each, slot.only)]
    if slot.optional and draw.random() < 0.5:
        return None
    schema = draw.choice(schemas)
    nested = any(each.role == slot.role for _, each in slots(schema))  # a sum of kernels; not without end
    return drawn(draw, schema if not nested or draw.random() < 0.3 else schemas[0])


def _value(draw: random.Random, annotation: Any, metadata: Sequence[Any], default: Any) -> Any:
    """A value of a type within its bounds, near the default; `_DEFAULT` for text and mappings."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _value(draw, parts[0], [*_constraints(parts[1:]), *metadata], default)
    if origin is Literal:
        return draw.choice(parts)
    if origin in (Union, types.UnionType):
        return _value(draw, draw.choice(parts), metadata, default)
    if origin is tuple:
        return _tuple(draw, parts, metadata, default)
    if annotation is bool:
        return draw.choice([True, False])
    if annotation is int:
        return _integer(draw, metadata)
    if annotation is float:
        return _number(draw, metadata, default if isinstance(default, int | float) else 1.0)
    return None if annotation is type(None) else _DEFAULT


def _constraints(metadata: Sequence[Any]) -> list[Any]:
    """The bounds in the arguments of `Annotated`, those in fields included."""
    return [mark for each in metadata for mark in (each.metadata if isinstance(each, FieldInfo) else [each])]


def _tuple(draw: random.Random, parts: Sequence[Any], metadata: Sequence[Any], default: Any) -> list[Any]:
    defaults = list(default) if isinstance(default, list | tuple) else []
    if parts[-1] is ...:
        shortest = _bound(metadata, annotated_types.MinLen, "min_length", 0)
        longest = _bound(metadata, annotated_types.MaxLen, "max_length", math.inf)
        length = int(min(shortest + draw.randint(0, MOST_ENTRIES), longest))
        parts = [parts[0]] * length
        defaults = (defaults or [None]) * max(length, 1)
    defaults += [None] * (len(parts) - len(defaults))
    return [_value(draw, part, (), near) for part, near in zip(parts, defaults, strict=False)]


def _integer(draw: random.Random, metadata: Sequence[Any]) -> int:
    low, high = _interval(metadata, 1, 0, math.inf)
    factor = _bound(metadata, annotated_types.MultipleOf, "multiple_of", 1)
    value = int(min(low + draw.randint(0, SMALL), high))
    return math.ceil(value / factor) * factor


def _number(draw: random.Random, metadata: Sequence[Any], default: float) -> float:
    low, high = _interval(metadata, 1e-6, -math.inf, math.inf)
    if draw.random() < 0.1 and math.isfinite(draw.choice([low, high])):
        return float(low if math.isfinite(low) else high)  # a bound
    scale = draw.choice([-1.0, 1.0]) if low < 0 else 1.0
    value = scale * (default or draw.random()) * 4.0 ** draw.uniform(-1.0, 1.0)
    return float(min(max(value, low), high))


def _interval(metadata: Sequence[Any], margin: float, lowest: float, highest: float) -> tuple[float, float]:
    """The closed interval of the bounds; `margin` is the distance that is kept from an open bound."""
    low = _bound(metadata, annotated_types.Ge, "ge", lowest)
    low = max(low, _bound(metadata, annotated_types.Gt, "gt", -math.inf) + margin)
    high = _bound(metadata, annotated_types.Le, "le", highest)
    high = min(high, _bound(metadata, annotated_types.Lt, "lt", math.inf) - margin)
    return low, high


def _bound(metadata: Sequence[Any], kind: type, name: str, otherwise: Any) -> Any:
    return next((getattr(mark, name) for mark in metadata if isinstance(mark, kind)), otherwise)
