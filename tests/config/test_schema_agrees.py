"""Schemas, constructors and docstrings agree: nothing is configured in vain, left to chance or told twice."""

import importlib
import inspect
import pkgutil
import re

import pytest

import bojax
from bojax.config.catalog import kinds, roles
from bojax.config.component import import_target
from bojax.engine.build import build
from tests.parts import FILES, REQUIRED

COMPONENTS = [(role, kind, schema) for role in roles() for kind, schema in kinds(role).items()]
each_schema = pytest.mark.parametrize("schema", [pytest.param(s, id=f"{r}-{k}") for r, k, s in COMPONENTS])

WITHOUT_PARTS = ("bojax.cli", "bojax.report")
"""Packages without parts of a role."""


@each_schema
def test_schema_and_constructor_take_the_same_settings(schema):
    configured = set(schema.model_fields) - {"kind"}
    parameters = inspect.signature(import_target(schema.target)).parameters
    if schema.role == "experiment":
        configured -= {"dtype"}  # how to build it, which its constructor need not know
    required = {name for name, parameter in parameters.items() if parameter.default is parameter.empty}
    assert configured <= set(parameters)
    assert required <= configured


@each_schema
def test_the_defaults_of_every_part_build(schema, write):
    for name, text in FILES.items():
        write(name, text)
    kind = schema.model_fields["kind"].default
    assert isinstance(build(schema(**REQUIRED.get(kind, {}))), import_target(schema.target))


@each_schema
def test_a_class_names_its_schema_and_does_not_repeat_it(schema):
    docstring = inspect.getdoc(import_target(schema.target))
    (line,) = re.findall(r"^Settings: (.+)$", docstring, re.MULTILINE)
    assert f"`{schema.__module__}." in line and re.search(rf"\b{schema.__name__}`", line)
    attributes = docstring.partition("Attributes:\n")[2]
    assert not set(re.findall(r"^ {4}(\w+):", attributes, re.MULTILINE)) & set(schema.model_fields)


@each_schema
def test_every_setting_says_what_it_means(schema):
    for name, field in schema.model_fields.items():
        assert name == "kind" or field.description


@pytest.fixture(scope="module")
def classes():
    """All concrete public classes of the package."""
    names = [module.name for module in pkgutil.walk_packages(bojax.__path__, "bojax.")]
    modules = [
        importlib.import_module(name)
        for name in names
        if not name.startswith(WITHOUT_PARTS) and not name.endswith("__main__")
    ]
    found = {part for module in modules for part in vars(module).values() if isinstance(part, type)}
    public = {part for part in found if not part.__name__.startswith("_")}
    return {part for part in public if part.__module__.startswith("bojax.") and not inspect.isabstract(part)}


@pytest.mark.parametrize("role", [role for role, base in roles().items() if base.protocol])
def test_every_concrete_class_of_a_role_has_a_schema(role, classes):
    protocol = import_target(roles()[role].protocol)
    targets = {import_target(schema.target) for schema in kinds(role).values()}
    assert {part for part in classes if issubclass(part, protocol)} == targets
