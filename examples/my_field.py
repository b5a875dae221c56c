"""Monitor a field of my own: the errors of kCBTS on a ridge, in 8 runs at once."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Scalar

import bojax
from bojax.experiments.planning import PlanningEpisode
from bojax.fields.base import Field


class Ridge(Field):
    """A ridge along the diagonal, of this width in metres."""

    width: Float[Array, ""]

    def __call__(self, x: Float[Array, "2"]) -> Scalar:
        """Value at a point, in metres."""
        return jnp.exp(-(((x[0] - x[1]) / self.width) ** 2))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    problem = bojax.part("monitoring", field=Ridge(jnp.asarray(1.0)), max_steps=10)
    episode = PlanningEpisode(problem, bojax.part("kcbts", iterations=50, exploration=100.0))

    def run(key):
        """One episode, as its row of `runs.parquet`."""
        end, _ = jax.lax.scan(lambda carry, _: episode.advance(carry), episode.init(key), length=10)
        return episode.summary(end)

    scores = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 8))
    print("return:", scores["return"])
    print("RMSE:", scores["rmse"])
