"""The target return of a learning run: when the test episodes reached it, and their returns since then."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Scalar

from bojax.results.schema import Column, Table


class TargetProgress(eqx.Module):
    """Progress of the test episodes of a run towards a target return."""

    # Training episodes before the first round of tests that all exceeded the target; -1 until then
    episodes: Int[Array, ""]
    tests_after: Int[Array, ""]  # number of test episodes since then
    return_after: Float[Array, ""]  # sum of their returns

    @property
    def is_reached(self) -> Bool[Array, ""]:
        """Whether the target has been reached."""
        return self.episodes >= 0

    def after_tests(
        self,
        returns: Float[Array, "N"],
        target: Float[Array, ""],
        episode: Int[Array, ""],
        is_active: Bool[Array, ""],
    ) -> "TargetProgress":
        """The progress after a round of tests, which all have to exceed `target`; unchanged if not active."""
        is_new = is_active & ~self.is_reached & jnp.all(returns > target)
        is_after = is_active & self.is_reached
        return TargetProgress(
            episodes=jnp.where(is_new, episode, self.episodes),
            tests_after=self.tests_after + jnp.where(is_after, len(returns), 0),
            return_after=self.return_after + jnp.where(is_after, jnp.sum(returns), 0.0),
        )

    def summary(self) -> dict[str, Scalar]:
        """The values of `TARGET_COLUMNS`."""
        return {
            "reached": self.is_reached,
            "episodes_to_target": self.episodes,
            "return_after_target": self.return_after / self.tests_after.astype(self.return_after.dtype),
        }


TARGET_COLUMNS: Table = (
    Column("reached", "bool", "", "all test episodes after some training episode exceeded the target"),
    Column("episodes_to_target", "int32", "", "training episodes until this happened", nullable=True),
    Column(
        "return_after_target", "float64", "", "mean return of the test episodes after that", nullable=True
    ),
)
