"""Field monitoring as a planner imagines it: drive, look, refit (Sections 3.3.2 and 4.7.1)."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.reference.gaussian_process import GP
from tests.reference.parking import place


@dataclass(frozen=True)
class Belief:
    """The robot's pose, and all that it saw or imagined to see.

    Attributes:
        pose: x, y and heading.
        x: Where it looked.
        y: What it saw.
        refit: From `x` and `y` to a Gaussian process.
    """

    pose: np.ndarray
    x: np.ndarray
    y: np.ndarray
    refit: Callable[[np.ndarray, np.ndarray], GP]

    @functools.cached_property
    def gp(self):
        return self.refit(self.x, self.y)


@dataclass(frozen=True)
class Objective:
    """The sum over the samples of what each is worth.

    Attributes:
        kind: The gradient's norm (3.2), the value (4.11), or the uncertainty alone.
        kappa: Weight of the uncertainty beside them.
        uncertainty: `"std"` or `"variance"`.
    """

    kind: str
    kappa: float
    uncertainty: str

    def __call__(self, gp, points, mean, variance):
        spread = np.sqrt(variance) if self.uncertainty == "std" else variance
        if self.kind == "uncertainty":
            return spread.sum()
        if self.kind == "value":
            return (mean + self.kappa * spread).sum()
        return (np.linalg.norm(gp.gradient(points), axis=1) + self.kappa * spread).sum()


@dataclass(frozen=True)
class Monitoring:
    """The problem as a planner knows it.

    Attributes:
        walls: [W, 4]; no rows if there are none.
    """

    objective: Objective
    domain: np.ndarray
    walls: np.ndarray
    collision_reward: float
    exit_reward: float
    after_collision: str

    def drive(self, belief, path, innovations):
        """The belief, the reward and whether the episode is over after driving `path` from `belief`.

        The samples are paid under the belief before them; then they are imagined, drawn together from
        what that belief predicts, and the belief is fitted anew with them.
        """
        path = place(path, belief.pose)
        number, collided, exited = self.follow(belief.pose, path)
        points = path[:number, :2]
        reward = self.collision_reward * collided + self.exit_reward * exited
        y = belief.y
        if number > 0:
            mean, covariance = belief.gp.predict(points)
            reward += self.objective(belief.gp, points, mean, np.maximum(np.diag(covariance), 0.0))
            joint = np.linalg.cholesky(covariance + belief.gp.noise_variance * np.eye(number))
            y = np.concatenate([y, mean + joint @ innovations[:number]])
        pose = np.array(path[number - 1] if number > 0 else belief.pose)
        if (collided or exited) and self.after_collision == "turn":
            pose[2] += math.pi
        pose[2] %= 2.0 * math.pi
        return Belief(pose, np.concatenate([belief.x, points]), y, belief.refit), reward, False

    def follow(self, pose, path):
        """How many poses of `path` the robot reaches, and whether a wall or the border stopped it there."""
        begin, end = np.vstack([pose[:2], path[:-1, :2]]), path[:, :2]
        is_hit = segments_touch_boxes(begin, end, self.walls).any(axis=1)
        is_outside = ((end < self.domain[:2]) | (end > self.domain[2:])).any(axis=1)
        blocked = np.flatnonzero(is_hit | is_outside)
        if len(blocked) == 0:
            return len(path), False, False
        return blocked[0], is_hit[blocked[0]], not is_hit[blocked[0]]


def segments_touch_boxes(begin, end, boxes):
    """[N, W]: no axis separates the two, of those that can: x, y, and the normal of the line piece."""
    begin, end = begin[:, None], end[:, None]
    is_apart = (np.maximum(begin, end) < boxes[:, :2]) | (np.minimum(begin, end) > boxes[:, 2:])
    # Which side of the line the box's corners lie on.
    corners = np.stack([boxes[:, [i, j]] for i in (0, 2) for j in (1, 3)])
    (dx, dy), to = np.moveaxis(end - begin, -1, 0), np.moveaxis(corners[:, None] - begin, -1, 0)
    side = dx * to[1] - dy * to[0]
    return ~(is_apart.any(axis=-1) | (side > 0.0).all(axis=0) | (side < 0.0).all(axis=0))
