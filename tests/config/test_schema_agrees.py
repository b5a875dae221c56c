"""Schema fields and constructor fields are one list: nothing is configured in vain or left to chance."""

import inspect

import pytest

from bojax.config.catalog import kinds, roles
from bojax.engine.build import build, import_target

EXAMPLES = {
    "grid": {"file": "grid.csv", "extent": (0.0, 0.0, 1.0, 1.0)},
    "scattered": {"file": "rows.csv", "extent": (0.0, 0.0, 1.0, 1.0)},
    "gymnasium": {"id": "MountainCar-v0"},
    "brax": {"name": "fast"},
    "learning": {"env": "mountain-car", "learner": "emu-q"},
}
"""Settings of the kinds that have no default for all of theirs."""

COMPONENTS = [(role, kind, schema) for role in roles() for kind, schema in kinds(role).items()]


@pytest.mark.parametrize("schema", [pytest.param(s, id=f"{r}-{k}") for r, k, s in COMPONENTS])
def test_schema_and_constructor_take_the_same_settings(schema):
    configured = set(schema.model_fields) - {"kind"}
    parameters = inspect.signature(import_target(schema.target)).parameters
    if schema.role == "experiment":
        configured -= {"dtype"}  # how to build it, which its constructor need not know
    required = {name for name, parameter in parameters.items() if parameter.default is parameter.empty}
    assert configured <= set(parameters)
    assert required <= configured


@pytest.mark.parametrize("schema", [pytest.param(s, id=f"{r}-{k}") for r, k, s in COMPONENTS])
def test_the_defaults_of_every_part_build(schema, write):
    write("grid.csv", "1,2\n3,4")
    write("rows.csv", "x,y,value\n0,0,1\n1,0,2\n0,1,3")
    kind = schema.model_fields["kind"].default
    assert isinstance(build(schema(**EXAMPLES.get(kind, {}))), import_target(schema.target))
