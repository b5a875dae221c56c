"""Problems whose state is the robot's pose, known to the planner through a noisy reading of it."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.motions.base import Path, Pose, place
from bojax.problems.base import Events, Objective, Problem, Simulation


class Outcome(eqx.Module):
    """What driving a path leads to.

    Attributes:
        reward: Reward of the path.
        terminated: The episode is over; the robot drives every other path to its end.
        success: The task is solved.
        exited: The robot left the domain.
        last: Index of the last pose driven.
    """

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    success: Bool[Array, ""]
    exited: Bool[Array, ""]
    last: Int[Array, ""]


class PoseProblem(Problem):
    """A problem told by its start and by the outcome of a path; a subclass writes these two methods.

    The robot follows a path exactly. The planner knows the model and sees only a reading of the pose with
    Gaussian noise: its belief is the last reading, and it simulates as if that were the pose.

    Attributes:
        position_noise: Standard deviation of a position reading, per axis, in metres.
        heading_noise: Standard deviation of a heading reading, in radians.
    """

    position_noise: eqx.AbstractVar[Float[Array, ""]]
    heading_noise: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        """What happens when the robot drives from `start` through the poses of `path` (world frame)."""

    def prior(self, key: Key[Array, ""], world: Pose, num_samples: int) -> Pose:
        """The first reading."""
        del num_samples
        return self._read(key, world)

    def execute(self, key: Key[Array, ""], world: Pose, path: Path) -> tuple[Pose, Pose, Events]:
        """Drive a path from the true pose and read the pose it ends in."""
        poses = place(path, world)
        outcome = self.outcome(world, poses)
        index = jnp.arange(poses.shape[0], dtype=outcome.last.dtype)
        driven = poses[jnp.minimum(index, outcome.last)]
        end = driven[-1].at[2].set(jnp.mod(driven[-1, 2], 2.0 * jnp.pi))
        events = Events(
            reward=outcome.reward,
            terminated=outcome.terminated,
            success=outcome.success,
            exited=outcome.exited,
            driven=driven,
            is_driven=index <= outcome.last,
        )
        return end, self._read(key, end), events

    def update(self, belief: Pose, path: Path, observation: Pose) -> Pose:
        """The last reading."""
        del belief, path
        return observation

    def reward(self, objective: Objective, belief: Pose, path: Path, events: Events) -> Scalar:
        """The world's own reward."""
        del objective, belief, path
        return events.reward

    def root(self, belief: Pose, horizon: int) -> tuple[None, Pose]:
        """Nodes are poses and share nothing."""
        del horizon
        return None, belief

    def simulate(
        self,
        key: Key[Array, ""],
        root: None,
        node: Pose,
        paths: Float[Array, "H S 3"],
        objective: Objective,
    ) -> Simulation:
        """Drive the paths one after the other, without noise.

        The starts follow from the ends of the paths alone, so that all outcomes are one batch: what comes
        after a terminated path does not count.
        """
        del key, root, objective
        starts = [node]
        for path in paths:
            starts.append(place(path[-1], starts[-1]))
        begin = jnp.stack(starts[:-1])
        outcome = jax.vmap(lambda start, path: self.outcome(start, place(path, start)))(begin, paths)
        return Simulation(starts[1], outcome.reward, outcome.terminated)

    def pose(self, world: Pose) -> Pose:
        """The state itself."""
        return world

    def _read(self, key: Key[Array, ""], pose: Pose) -> Pose:
        noise = jnp.stack([self.position_noise, self.position_noise, self.heading_noise])
        return pose + noise * jax.random.normal(key, (3,), pose.dtype)
