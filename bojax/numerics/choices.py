"""Choices between cheap alternatives as array leaves: points that differ in one share a compiled program."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


class Choice(eqx.Module):
    """One of several names."""

    index: Int[Array, ""]  # position of the name
    names: tuple[str, ...] = eqx.field(static=True)  # all names

    def is_(self, name: str) -> Bool[Array, ""]:
        """Whether this name is chosen."""
        return self.index == self.names.index(name)


def one_of(*names: str) -> Callable[["str | Choice"], Choice]:
    """The converter of a field that takes one of these names; it raises ValueError for any other."""

    def convert(value: "str | Choice") -> Choice:
        if isinstance(value, Choice):
            return value
        if value not in names:
            raise ValueError(f'got "{value}"; allowed: {", ".join(names)}')
        return Choice(jnp.asarray(names.index(value), jnp.int32), names)

    return convert
