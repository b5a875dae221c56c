"""Every import of the package is declared in pyproject.toml, and every declared package is pinned."""

import ast
import importlib.metadata
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import bojax

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = {
    extra: [Requirement(text) for text in texts] for extra, texts in PROJECT["optional-dependencies"].items()
}
DISTRIBUTIONS = {"mlflow": ["mlflow-skinny"]}
DISTRIBUTIONS |= dict(importlib.metadata.packages_distributions())
"""By the name of a module, the distributions that bring it; those of extras need not be installed."""

REQUIRED = [Requirement(text) for text in PROJECT["dependencies"]]
PINNED = ("geo", "ray", "gym", "tensorboard", "wandb", "mlflow", "test")
"""Extras whose versions are pinned; the others are chosen by the machine, or are not needed by the tests."""


def names_of(requirements) -> set[str]:
    return {canonicalize_name(requirement.name) for requirement in requirements}


def imports_of(tree: ast.AST, is_optional: bool = False) -> Iterator[tuple[str, bool]]:
    """Top-level names of the modules that a file imports, and whether it can be imported without them."""
    for node in ast.iter_child_nodes(tree):
        is_for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        is_guarded = isinstance(node, ast.Try | ast.FunctionDef | ast.AsyncFunctionDef)
        is_needed = isinstance(node, ast.With) and ast.unparse(node.items[0]).startswith("needed(")
        optional = is_optional or is_for_types or is_guarded or is_needed
        if isinstance(node, ast.Import):
            yield from ((alias.name.partition(".")[0], optional) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0], optional
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            if isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value).partition(".")[0], optional
        yield from imports_of(node, optional)


def undeclared(source: str) -> set[str]:
    """Modules of other distributions that the source imports without a declaration that covers them."""
    always = names_of(REQUIRED)
    sometimes = always.union(*map(names_of, EXTRAS.values()))
    found = set()
    for name, is_optional in imports_of(ast.parse(source)):
        if name == "bojax" or name in sys.stdlib_module_names:
            continue
        providers = {canonicalize_name(provider) for provider in DISTRIBUTIONS.get(name, [name])}
        if not providers & (sometimes if is_optional else always):
            found.add(name)
    return found


def test_every_import_is_declared():
    files = {path.relative_to(ROOT): undeclared(path.read_text()) for path in (ROOT / "bojax").rglob("*.py")}
    assert len(files) > 100
    assert {file: names for file, names in files.items() if names} == {}


@pytest.mark.parametrize("constraints", ["py311.txt", "py312.txt"])
def test_every_declared_package_is_pinned_to_a_version_that_is_allowed(constraints):
    pins = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints" / constraints).read_text(), re.M))
    pins = {canonicalize_name(name): version for name, version in pins.items()}
    requirements = [*REQUIRED, *(requirement for extra in PINNED for requirement in EXTRAS[extra])]
    assert names_of(requirements) <= pins.keys()
    refused = [r.name for r in requirements if not r.specifier.contains(pins[canonicalize_name(r.name)])]
    assert refused == []


def test_the_version_is_the_same_everywhere():
    changes = re.findall(r"^## (\d\S*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    (cited,) = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert changes[0] == cited == bojax.__version__
