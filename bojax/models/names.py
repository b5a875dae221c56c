"""Parts by name: the names and the settings of config files, for kernels and acquisition functions."""

from collections.abc import Callable, Mapping
from typing import Any

from bojax.config.component import Component, External, import_target
from bojax.config.errors import ConfigError


def by_name(role: str) -> Callable[[Any], Any]:
    """A converter of a field or an argument, from a name or a mapping of settings to the part.

    Names, settings and defaults are those of config files: `"matern52"`, or `{"kind": "matern52",
    "lengthscale": [1, 2]}`. Anything else is returned as it is. The converter raises ConfigError, a
    ValueError of one line, for an unknown name or a wrong setting.
    """

    def convert(given: Any) -> Any:
        if not isinstance(given, str | Mapping):
            return given
        from bojax.config.catalog import named  # imports the settings of every room

        return _constructed(named(role, given))

    return convert


def _constructed(component: Component) -> Any:
    """The part of these settings; its constructor converts numbers to arrays of JAX's default precision."""
    if isinstance(component, External):
        raise ConfigError(
            f"{component.slot}: got {component.kind}; allowed: a name, or an object of the class"
        )
    settings = {name: getattr(component, name) for name in type(component).model_fields if name != "kind"}
    parts = {name: _constructed(part) for name, part in settings.items() if isinstance(part, Component)}
    return import_target(component.target)(**settings | parts)
