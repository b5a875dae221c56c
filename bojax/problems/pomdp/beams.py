"""A range finder with beams all around; one of them detects the target (VDP Tag and Sub Hunt)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.problems.pomdp.readings import Reading


class Beams(Reading):
    """Independent Gaussian readings: one distribution for the target's beam, one for all others."""

    index: Int[Array, ""]  # the target's beam
    mean: Float[Array, ""]  # mean of its reading
    noise: Float[Array, ""]  # standard deviation of its reading
    other_mean: Float[Array, ""]  # mean of any other reading
    other_noise: Float[Array, ""]  # standard deviation of any other reading
    num: int = eqx.field(static=True)  # number of beams

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "O"]:
        is_target = self._is_target()
        mean = jnp.where(is_target, self.mean, self.other_mean)
        noise = jnp.where(is_target, self.noise, self.other_noise)
        return mean + noise * jax.random.normal(key, (self.num,), mean.dtype)

    @override
    def log_density(self, observation: Float[Array, "O"]) -> Float[Array, ""]:
        # The sum over other beams is the same for all particles, which thus evaluate one beam each.
        others = norm.logpdf(observation, self.other_mean, self.other_noise)
        reading = observation[self.index]
        instead = norm.logpdf(reading, self.other_mean, self.other_noise)
        return jnp.sum(others) - instead + norm.logpdf(reading, self.mean, self.noise)

    def _is_target(self) -> Bool[Array, "O"]:
        return jnp.arange(self.num, dtype=jnp.int32) == self.index


def beam_towards(offset: Float[Array, "2"], num: int) -> Int[Array, ""]:
    """The beam that covers a direction: beam i covers angles in (i, i + 1] turns / num, and 0 is a turn."""
    angle = jnp.arctan2(offset[1], offset[0])
    angle = jnp.where(angle <= 0.0, angle + 2.0 * jnp.pi, angle)
    return jnp.clip(jnp.ceil(num * (angle / (2.0 * jnp.pi))).astype(jnp.int32) - 1, 0, num - 1)
