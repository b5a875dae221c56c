"""A problem of my own: drive to a charging dock without hitting a pillar."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.problems.pose import Outcome, PoseProblem
from bojax.results.outline import Outline


class Dock(PoseProblem):
    """Reach the disc of radius `dock_radius` at the origin; driving into the pillar ends the episode.

    Every array field is a setting that can be swept; `eqx.field(static=True)` marks what fixes shapes.
    """

    dock_radius: Float[Array, ""]  # m
    pillar: Float[Array, "3"]  # x, y and radius, m
    position_noise: Float[Array, ""]  # standard deviation of a reading, m
    heading_noise: Float[Array, ""]  # rad
    max_steps: int = eqx.field(static=True, default=10)

    def outline(self) -> Outline:
        """What figures and films draw: discs are x, y and radius, boxes x_min, y_min, x_max, y_max."""
        return Outline(obstacles=[self.pillar], goals=[(0.0, 0.0, self.dock_radius)])

    def start(self, key: Key[Array, ""]) -> Pose:
        """A start 3 m to the left, at a random height, facing the pillar and the dock behind it."""
        y = jax.random.uniform(key, (), self.pillar.dtype, -1.0, 1.0)
        return jnp.stack([jnp.full_like(y, -3.0), y, jnp.zeros_like(y)])

    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        """What driving through the poses of `path` leads to; both are in the world's frame."""
        del start
        x, y = path[:, 0], path[:, 1]
        distance = jnp.sqrt(x**2 + y**2)
        is_docked = distance <= self.dock_radius
        is_hit = jnp.sqrt((x - self.pillar[0]) ** 2 + (y - self.pillar[1]) ** 2) <= self.pillar[2]
        is_over = is_docked | is_hit
        # The robot stops at the first pose that ends the episode, otherwise at the end of the path.
        last = jnp.where(jnp.any(is_over), jnp.argmax(is_over), path.shape[0] - 1)
        success, crashed = is_docked[last], is_hit[last]
        reward = jnp.where(crashed, -100.0, jnp.where(success, 100.0, -distance[last]))
        return Outcome(reward, terminated=success | crashed, success=success, exited=crashed, last=last)
