"""Every part found by discovery, with tiny settings, for the tests that hold for all parts of a role."""

from typing import Any

from bojax.config.catalog import kinds
from bojax.config.component import Component, slots

REQUIRED: dict[str, dict[str, Any]] = {
    "grid": {"file": "grid.csv", "extent": (0.0, 0.0, 1.0, 1.0)},
    "scattered": {"file": "rows.csv", "extent": (0.0, 0.0, 1.0, 1.0)},
    "outline": {"file": "area.geojson"},
    "route": {"file": "way.csv"},
    "gymnasium": {"id": "MountainCar-v0"},
    "brax": {"name": "fast"},
    "learning": {"env": "mountain-car", "learner": "emu-q"},
}
"""Settings of the kinds that do not have a default for each of theirs."""

FILES = {
    "grid.csv": "1,2\n3,4",
    "rows.csv": "x,y,value\n0,0,1\n1,0,2\n0,1,3",
    "way.csv": "x,y\n1,1\n4,1\n4,4",
    "area.geojson": '{"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [0, 1], [0, 0]]], "crs": null}',
}
"""The data files that these settings name."""

TINY: dict[str, Any] = {
    "batch_size": 4,
    "depth": 2,
    "impl": "c",  # compiles in no time; `robots/test_simulator.py` compares MJX in JAX
    "integrator": "euler",  # the packaged models' RK4 evaluates the dynamics four times
    "iteration_steps": 4,
    "iterations": 6,
    "max_actions": 4,
    "max_levels": 3,
    "max_steps": 3,
    "min_pool": 2.0,
    "model_updates": 3,
    "num_actions": 3,
    "num_candidates": 4,
    "num_features": 8,
    "num_heads": 2,
    "num_outputs": 3,
    "num_particles": 8,
    "num_rollout_paths": 3,
    "num_samples": 3,
    "path_steps": 40,
    "resolution": 5,
    "rest_steps": 10,
    "width": 5,
}
"""Small values of settings that cost time; a part takes those that it has."""


def first_kinds(role: str) -> list[str]:
    """The kinds of a role without those that are another kind of the same class with other defaults."""
    first: dict[str, str] = {}
    for kind, schema in kinds(role).items():
        first.setdefault(schema.target, kind)
    return list(first.values())


def tiny(role: str, kind: str, **settings: Any) -> Component:
    """A part with small budgets, those of the parts in its slots included."""
    schema = kinds(role)[kind]
    return schema.model_validate(_tiny_settings(schema) | settings)


def _tiny_settings(schema: type[Component]) -> dict[str, Any]:
    kind = schema.model_fields["kind"].default
    settings = {name: value for name, value in TINY.items() if name in schema.model_fields}
    for name, _ in slots(schema):
        default = schema.model_fields[name].default
        if isinstance(default, Component):
            settings[name] = _tiny_settings(type(default))
    return {"kind": kind, **settings, **REQUIRED.get(kind, {})}
