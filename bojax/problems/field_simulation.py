"""Simulation of action sequences from a belief about a field, without refitting it (one Schur complement)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from bojax.models.lookahead import LookaheadRoot, look_ahead
from bojax.motions.base import Pose
from bojax.problems.arena import Arena
from bojax.problems.objectives import FieldObjective, JointObjective
from bojax.problems.path_problem import Simulation


class FieldNode(eqx.Module):
    """A belief of the search tree: the samples imagined since the root."""

    # One array, since a search writes a node in every iteration, and each array costs a GPU a kernel.
    # The first row holds the pose of the robot and the number of actions since the root, the others the
    # samples
    rows: Float[Array, "*N R 4"]
    left: Float[Array, "*N"] | None = None  # distance left of the budget, m; None without a budget

    @classmethod
    def of(
        cls,
        pose: Pose,
        level: Float[Array, ""],
        samples: Float[Array, "B 4"],
        left: Float[Array, ""] | None = None,
    ) -> "FieldNode":
        """The node with these parts."""
        return cls(jnp.concatenate([jnp.append(pose, level)[None], samples]), left)

    @property
    def pose(self) -> Float[Array, "*N 3"]:
        """Pose of the robot."""
        return self.rows[..., 0, :3]

    @property
    def level(self) -> Float[Array, "*N"]:
        """Number of actions since the root."""
        return self.rows[..., 0, 3]

    @property
    def samples(self) -> Float[Array, "*N B 4"]:
        """Imagined samples, action by action; those of the last action are never conditioned on.

        A row holds x and y, the imagined innovation (see `look_ahead`), and 1 for a sample that was taken,
        else 0.
        """
        return self.rows[..., 1:, :]

    @property
    def points(self) -> Float[Array, "*N B 2"]:
        """Positions of the samples."""
        return self.samples[..., :2]

    @property
    def innovations(self) -> Float[Array, "*N B"]:
        """Imagined innovations of the samples."""
        return self.samples[..., 2]

    @property
    def is_taken(self) -> Bool[Array, "*N B"]:
        """Whether each sample was taken."""
        return self.samples[..., 3] > 0.0


def root_node(
    pose: Pose, horizon: int, num_samples: int, dtype, left: Float[Array, ""] | None = None
) -> FieldNode:
    """The root, with room for the samples of all actions up to the horizon but the last."""
    samples = jnp.zeros(((horizon - 1) * num_samples, 4), dtype)
    return FieldNode.of(pose, jnp.zeros((), dtype), samples, left)


def simulate_paths(
    key: Key[Array, ""],
    root: LookaheadRoot,
    node: FieldNode,
    paths: Float[Array, "H S 3"],
    objective: FieldObjective,
    arena: Arena,
    imagined: Literal["sample", "mean"],
) -> Simulation:
    """Drive paths one after the other from a node, and imagine their samples.

    All samples since the root, those of the node first, enter one look-ahead: no posterior is refitted.
    Samples past the horizon are dropped. A path that uses up the budget is terminal.
    """
    # Each path is driven from the end of the one before it: the number of paths is static, so this unrolls.
    num_paths, size = paths.shape[:2]
    room = node.samples.shape[0]
    horizon = room // size + 1
    pose, drives, lefts = node.pose, [], [node.left]
    for path in paths:
        drive, left = arena.drive_within(pose, path, lefts[-1])
        drives.append(drive)
        lefts.append(left)
        pose = arena.end(drive)
    # Observations are imagined by their innovations: zeros give the predictive means, normal draws a sample
    # of the belief, and neither needs the belief that `look_ahead` is about to compute.
    innovations = jnp.zeros((num_paths, size), paths.dtype)
    if imagined == "sample":
        innovations = jax.random.normal(key, (num_paths * size,), paths.dtype).reshape(num_paths, size)
    new = [
        jnp.column_stack([drive.poses[:, :2], seen, drive.is_driven.astype(seen.dtype)])
        for drive, seen in zip(drives, innovations, strict=True)
    ]
    # For each possible level of the node: its samples followed by the new ones, up to the horizon. The level
    # differs between lanes, so that all few layouts are made and one is selected: slices instead of a gather.
    nothing = [jnp.zeros((size, 4), paths.dtype)] * horizon
    by_level = [
        jnp.concatenate([node.samples[: level * size], *new, *nothing])[: horizon * size]
        for level in range(horizon)
    ]
    all_samples = FieldNode.of(pose, node.level, _choose(node.level, by_level))
    is_taken = all_samples.is_taken
    # The reward of a stage is the sum over its samples, under the belief before it (3.2, 4.11). The
    # look-ahead also holds the stages before the node: the paths are paid from the node's level on.
    if isinstance(objective, JointObjective):
        gains = objective.of_samples(root.posterior, root.places, all_samples.points, is_taken)
    else:
        ahead = look_ahead(
            root, all_samples.points, is_taken, all_samples.innovations, horizon, objective.needs_gradient
        )
        gains = jnp.where(is_taken, objective(ahead.mean, ahead.variance, ahead.gradient), 0.0)
    by_stage = jnp.pad(jnp.sum(gains.reshape(horizon, size), axis=-1), (0, num_paths))
    paid = _choose(node.level, [by_stage[level : level + num_paths] for level in range(horizon)])
    rewards = paid + jnp.stack([arena.cost(drive) for drive in drives])

    # The child holds the samples of the node and of the first path; those of the rollout, later stages, are
    # cleared.
    stage = (jnp.arange(room, dtype=jnp.int32) // size).astype(paths.dtype)
    samples = jnp.where((stage <= node.level)[:, None], all_samples.samples[:room], 0.0)
    child = FieldNode.of(arena.end(drives[0]), node.level + 1.0, samples, lefts[1])
    used = [left <= 0.0 for left in lefts[1:] if left is not None]
    return Simulation(child, rewards, jnp.stack(used) if used else jnp.zeros((num_paths,), bool))


def _choose(level: Float[Array, ""], options: list[Array]) -> Array:
    """`options[level]`, the last one past the end; elementwise arithmetic is cheaper than a gather."""
    chosen = options[-1]
    for index in range(len(options) - 2, -1, -1):
        chosen = jnp.where(level == index, options[index], chosen)
    return chosen
