"""Registration of every part: importing this module imports the `settings` module of every package.

The schema classes of a package's parts are in its module `settings`, which loads neither JAX nor matplotlib.
"""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import pydantic

from bojax.config.component import Component, Slot, registry
from bojax.config.errors import dotted, from_validation

_PACKAGE = Path(__file__).resolve().parent.parent

for _file in sorted(_PACKAGE.rglob("settings.py")):
    importlib.import_module(".".join(["bojax", *_file.relative_to(_PACKAGE).with_suffix("").parts]))


def roles() -> dict[str, type[Component]]:
    """The base classes of the roles that a configuration can fill, sorted by their headings."""
    bases = {base.role: base for base in Component.__subclasses__() if "plural" in vars(base)}
    return dict(sorted(bases.items(), key=lambda item: item[1].plural))


def kinds(role: str) -> dict[str, type[Component]]:
    """The built-in schema classes of a role, by kind."""
    return {kind: schema for kind, schema in registry.get(role, {}).items() if issubclass(schema, Component)}


def named(role: str, part: Any) -> Component:
    """The settings of a part that is given as in a config, by its name or as a mapping.

    Messages name a setting by its dotted path in a config.
    """
    slot: Any = Annotated[Component, Slot(role)]
    above = () if role == "experiment" else (role,)
    try:
        return pydantic.TypeAdapter(slot).validate_python(_plain(part))
    except pydantic.ValidationError as error:
        raise from_validation(error, lambda location: dotted((*above, *location)) or role) from error


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy and JAX as Python's, also in mappings; other values as they are."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value.tolist() if hasattr(value, "tolist") else value
