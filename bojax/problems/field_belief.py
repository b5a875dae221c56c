"""The belief of a robot that learns a field: its pose, and a Gaussian process conditioned on its samples."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.models.checks import Numbers, check_finite, is_known, to_point
from bojax.models.gaussian_process import GaussianProcess
from bojax.motions.base import Pose


class Samples(eqx.Module):
    """Observation of a path: the samples taken along it."""

    points: Float[Array, "S 2"]  # estimated positions of the samples
    values: Float[Array, "S"]  # measured values
    is_taken: Bool[Array, "S"]  # whether the robot reached the sample's pose
    pose: Pose  # estimated pose of the robot at the end
    left: Float[Array, ""] | None = None  # distance left of the budget, m; None without a budget


class FieldBelief(eqx.Module):
    """The robot's belief."""

    pose: Pose  # estimated pose of the robot
    posterior: GaussianProcess  # Gaussian process over the field
    step: Int[Array, ""]  # number of paths driven
    counts: Int[Array, "N"]  # number of samples held at the start and after each path; 0 for future paths
    key: Key[Array, ""]  # key from which hyper-parameter learning draws its starting points
    num_samples: int = eqx.field(static=True)  # largest number of samples per path
    left: Float[Array, ""] | None = None  # distance left of the budget, m; None without a budget

    def after(
        self, posterior: GaussianProcess, pose: Pose | Numbers, left: Float[Array, ""] | None = None
    ) -> "FieldBelief":
        """The belief after one more path, which led to this posterior and pose, and left this distance.

        Raises:
            ValueError: The pose is not finite, or more paths were driven than `max_steps` of the problem
                (unless compiled).
        """
        step, pose = self.step + 1, to_point("pose", pose, self.pose.dtype, 3)
        if is_known((self, posterior, pose)):
            check_finite("pose", pose)
            most = self.counts.shape[0] - 1
            if int(step) > most:
                raise ValueError(f"after: got path {int(step)}; allowed: up to {most}, `max_steps`")
        counts = self.counts.at[step].set(posterior.count, mode="drop")
        return replace(self, pose=pose, posterior=posterior, step=step, counts=counts, left=left)

    def predict_grid(
        self, grid: Float[Array, "G 2"], resolution: int
    ) -> tuple[Float[Array, "G"], Float[Array, "G"]]:
        """Posterior mean and variance on a grid, row by row: at once they would take N G numbers per run."""
        rows = grid.reshape(resolution, resolution, 2)
        mean, variance = jax.lax.map(self.posterior.predict, rows)
        return mean.ravel(), variance.ravel()

    def history(
        self, x: Float[Array, "R"], y: Float[Array, "R"]
    ) -> tuple[Float[Array, "N R R"], Float[Array, "N R R"]]:
        """Means and standard deviations on a grid after every path, in 32 bits; NaN for future paths.

        All of them are conditioned under the current hyper-parameters. The grid is processed row by row.
        """
        is_made = jnp.arange(self.counts.shape[0], dtype=self.step.dtype) <= self.step

        def row(y: Scalar) -> tuple[Float[Array, "N R"], Float[Array, "N R"]]:
            points = jnp.stack([x, jnp.full_like(x, y)], axis=-1)
            mean, variance = self.posterior.predict_first(points, self.counts)
            kept = (jnp.where(is_made[:, None], part, jnp.nan) for part in (mean, jnp.sqrt(variance)))
            mean, std = (part.astype(jnp.float32) for part in kept)
            return mean, std

        means, stds = jax.lax.map(row, y)
        return jnp.swapaxes(means, 0, 1), jnp.swapaxes(stds, 0, 1)
