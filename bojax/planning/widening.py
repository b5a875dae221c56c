"""Progressive widening: how many children a node has after a number of visits."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

_ROUNDING = 32
"""Distance from a whole number, in units of the last place, that is taken for an error of a power."""


class Widening(eqx.Module):
    """Progressive widening: another child is added iff their number is at most k n^alpha after n visits."""

    coefficient: Float[Array, ""]  # the factor k
    exponent: Float[Array, ""]  # the exponent alpha, in [0, 1]

    def thresholds(self, capacity: int) -> Float[Array, "C"]:
        """Visits after which child j may be added: max(j, (j / k)^(1 / alpha)).

        With alpha <= 1, k n^alpha is the slower of the two, once it has fallen behind n: the rule adds one
        child a visit until then, and child j at the first visit n with j <= k n^alpha from then on. So the
        number of children is a function of the visits, which no node has to store; where equal observations
        share a branch, there may be fewer.
        """
        index = jnp.arange(capacity, dtype=self.coefficient.dtype)
        # The first child needs no visit: 0^0 would be 1.
        needed = jnp.where(index > 0.0, (index / self.coefficient) ** (1.0 / self.exponent), 0.0)
        # A power is rounded differently on each device; at a whole number, that would cost a visit.
        whole = jnp.round(needed)
        needed = jnp.where(
            abs(needed - whole) <= _ROUNDING * jnp.finfo(needed.dtype).eps * whole, whole, needed
        )
        return jnp.maximum(index, needed)
