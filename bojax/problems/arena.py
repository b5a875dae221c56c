"""The area that a field robot moves in: border, walls, target area, and the cost of running into them."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, Scalar

from bojax.areas.outlined import OutlinedArea
from bojax.models.checks import compiled_if_known
from bojax.motions.base import Path, Pose, place
from bojax.numerics.angles import wrap_to_2pi
from bojax.problems.walls import Boxes, Drive, drive_until_blocked, is_free
from bojax.problems.ways_to_end import WaysToEnd
from bojax.results.outline import Outline

START_TRIES = 256  # number of random poses that a random start is searched in: the first free one


class Arena(eqx.Module):
    """Geometry of a field problem, see `FieldProblem` for the attributes."""

    domain: Float[Array, "4"]
    margin: Float[Array, ""]
    walls: Boxes | None
    target_area: Float[Array, "4"] | None
    collision_reward: Float[Array, ""]
    exit_reward: Float[Array, ""]
    after_collision: Literal["stop", "turn"] = eqx.field(static=True)
    ways: WaysToEnd | None = None
    area: OutlinedArea | None = None

    @property
    def border(self) -> Float[Array, "4"]:
        """The border that stops the robot, `margin` outside the domain, as `[x_min, y_min, x_max, y_max]`."""
        return self.domain + self.margin * jnp.asarray([-1.0, -1.0, 1.0, 1.0], self.domain.dtype)

    def random_pose(self, key: Key[Array, ""]) -> Pose:
        """A pose drawn uniformly from the free space and all headings."""
        # Rejection sampling with a fixed number of tries, as shapes are static; without a free one, the first
        # try.
        low_x, low_y, high_x, high_y = self.domain
        low = jnp.stack([low_x, low_y, jnp.zeros_like(low_x)])
        high = jnp.stack([high_x, high_y, 2.0 * jnp.pi])
        poses = jax.random.uniform(key, (START_TRIES, 3), low.dtype, low, high)
        return poses[jnp.argmax(self.is_free(poses[:, :2]))]

    def is_free(self, points: Float[Array, "N 2"]) -> Bool[Array, "N"]:
        """Whether points lie in the domain, in the area, and outside all walls."""
        return is_free(points, self.domain, self.walls, self.area)

    def drive(self, pose: Pose, path: Path) -> Drive:
        """The part of a path that can be driven from a pose."""
        # The start is the origin of the path's frame. Placed together with the path, it is elementwise
        # arithmetic; joined to the placed path, it would cost a kernel on a GPU.
        trajectory = place(jnp.pad(path, ((1, 0), (0, 0))), pose)
        return drive_until_blocked(trajectory, self.border, self.walls, self.area)

    def drive_within(
        self, pose: Pose, path: Path, left: Float[Array, ""] | None
    ) -> tuple[Drive, Float[Array, ""] | None]:
        """The same within a distance, and what is left of it; None for any distance.

        With an end point, a robot with no more left than the way there drives it, at most as far as the path
        is long, whatever the path.
        """
        drive = self.drive(pose, path)
        if left is None:
            return drive, None
        if self.ways is None:
            return drive.within(pose, left)
        to_end = self.ways.reserve(jnp.concatenate([pose[None], drive.poses])[:, :2])
        # A path that has been cut leaves exactly the reserve: no further state is needed.
        returns = self.ways.must_return(pose[:2], left)
        both = self.ways.drive(pose, path), drive.within(pose, left, to_end)
        return jax.tree.map(lambda way, other: jnp.where(returns, way, other), *both)

    @eqx.filter_jit  # traced and lowered once where a program drives several times
    def end(self, driven: Drive) -> Pose:
        """Pose after a drive: its last pose, turned round if the robot was stopped and turns on the spot."""
        end = driven.poses[-1]
        is_turned = (driven.collided | driven.exited) & (self.after_collision == "turn")
        heading = end[2] + jnp.where(is_turned, jnp.pi, 0.0)
        return end.at[2].set(wrap_to_2pi(heading))

    def cost(self, driven: Drive) -> Scalar:
        """Reward, usually negative, for a collision or for leaving the domain."""
        return jnp.where(driven.collided, self.collision_reward, 0.0) + jnp.where(
            driven.exited, self.exit_reward, 0.0
        )

    def reaches_target(self, driven: Drive) -> Bool[Array, ""]:
        """Whether a drive passes through the target area; false without one."""
        if self.target_area is None:
            return jnp.zeros((), bool)
        points, low, high = driven.poses[:, :2], self.target_area[None, :2], self.target_area[None, 2:]
        is_there = jnp.all((points >= low) & (points <= high), axis=-1)
        return jnp.any(is_there & driven.is_driven)

    def axes(self, resolution: int) -> tuple[Float[Array, "R"], Float[Array, "R"]]:
        """Coordinates x and y of a regular grid over the domain."""
        low_x, low_y, high_x, high_y = self.domain
        return jnp.linspace(low_x, high_x, resolution), jnp.linspace(low_y, high_y, resolution)

    @compiled_if_known
    def grid(self, resolution: int) -> Float[Array, "G 2"]:
        """Points of a regular grid over the domain, in rows of equal y."""
        x, y = self.axes(resolution)
        return jnp.stack([g.ravel() for g in jnp.meshgrid(x, y)], axis=-1)

    def outline(self, start: Pose | None) -> Outline:
        """The arena as figures draw it, on the host."""
        return Outline(
            border=self.domain.tolist(),
            obstacles=[] if self.walls is None else self.walls.tolist(),
            goals=[] if self.target_area is None else [self.target_area.tolist()],
            start=None if start is None else start[:2].tolist(),
            area=[] if self.area is None else [ring.tolist() for ring in self.area.rings],
        )
