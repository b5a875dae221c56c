"""Parts by name: the names and the settings of config files, for kernels and acquisition functions."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from bojax.numerics.construct import construct


def by_name(role: str) -> Callable[[Any], Any]:
    """A converter of a field or an argument, from a name or a mapping of settings to the part.

    Names, settings and defaults are those of config files: `"matern52"`, or `{"kind": "matern52",
    "lengthscale": [1, 2]}`. Numbers have JAX's default precision. Anything else is returned as it is. The
    converter raises ConfigError, a ValueError of one line, for an unknown name or a wrong setting.
    """

    def convert(given: Any) -> Any:
        if not isinstance(given, str | Mapping):
            return given
        from bojax.config.catalog import named  # imports the settings of every room

        return construct(named(role, given), str(jnp.result_type(float)))

    return convert
