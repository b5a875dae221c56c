"""Schemas and constructors agree: nothing is configured in vain or left to chance."""

import importlib
import inspect
import pkgutil

import bojax
from bojax.config.catalog import kinds, roles
from bojax.config.component import import_target
from bojax.numerics.construct import HOW_TO_BUILD

SCHEMAS = [schema for role in roles() for schema in kinds(role).values()]

WITHOUT_PARTS = ("bojax.cli", "bojax.report")
"""Packages without parts of a role."""


def test_schema_and_constructor_take_the_same_settings():
    for schema in SCHEMAS:
        configured = set(schema.model_fields) - {"kind"}
        parameters = inspect.signature(import_target(schema.target)).parameters
        if schema.role == "experiment":
            configured -= {*HOW_TO_BUILD}  # which its constructor need not know
        required = {name for name, parameter in parameters.items() if parameter.default is parameter.empty}
        assert required <= configured <= set(parameters), schema


def test_every_concrete_class_of_a_role_has_a_schema():
    names = [module.name for module in pkgutil.walk_packages(bojax.__path__, "bojax.")]
    modules = [
        importlib.import_module(name)
        for name in names
        if not name.startswith(WITHOUT_PARTS) and not name.endswith("__main__")
    ]
    found = {part for module in modules for part in vars(module).values() if isinstance(part, type)}
    ours = {part for part in found if part.__module__.startswith("bojax.")}
    classes = {part for part in ours if not part.__name__.startswith("_") and not inspect.isabstract(part)}
    for role, base in roles().items():
        if base.protocol:
            targets = {import_target(schema.target) for schema in kinds(role).values()}
            assert {part for part in classes if issubclass(part, import_target(base.protocol))} == targets
