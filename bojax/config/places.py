"""The meaning of a dotted path in a configuration that is not validated yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bojax.config.component import Component, registry, slot_of


@dataclass(frozen=True)
class Place:
    """The setting at a path."""

    role: str | None = None  # role of the component at the path; None for a plain setting
    kind: str | None = None  # kind of the component, given or by default


def look_up(experiment: Mapping[str, Any], path: Sequence[str]) -> Place | None:
    """The setting at a path; None if the schemas have no such setting. Import paths are not followed."""
    place = Place("experiment", experiment.get("kind"))
    schema = registry.get("experiment", {}).get(str(place.kind))
    raw: Any = experiment
    default: Any = None
    for depth, name in enumerate(path):
        if schema is None:  # an import path or an unknown kind: any setting is possible
            return Place()
        if name not in schema.model_fields:
            return None
        field = schema.model_fields[name]
        default = getattr(default if isinstance(default, schema) else None, name, field.default)
        raw = raw.get(name) if isinstance(raw, Mapping) else None
        slot = slot_of(field)
        if slot is None:
            return Place() if depth == len(path) - 1 else None
        kind = raw.get("kind") if isinstance(raw, Mapping) else raw
        if kind is None and isinstance(default, Component):
            kind = default.kind
        place = Place(slot.role, kind if isinstance(kind, str) else None)
        schema = registry.get(slot.role, {}).get(str(kind))
    return place
