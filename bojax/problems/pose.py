"""Problems whose state is the robot's pose, known to the planner through a noisy reading of it."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.motions.base import Path, Pose, place
from bojax.problems.base import Events, Objective, Problem, Simulation
from bojax.problems.vehicles.base import Exact, Vehicle, VehicleState


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

    The planner knows the model, in which paths are followed exactly, and sees only a reading of the pose
    with Gaussian noise: its belief is the last reading, and it simulates as if that were the pose. In the
    world the `vehicle` follows the paths, by default exactly.

    Attributes:
        position_noise: Standard deviation of a position reading, per axis, in metres.
        heading_noise: Standard deviation of a heading reading, in radians.
        vehicle: Who follows the paths.
    """

    position_noise: eqx.AbstractVar[Float[Array, ""]]
    heading_noise: eqx.AbstractVar[Float[Array, ""]]
    vehicle: Vehicle = eqx.field(default_factory=Exact, kw_only=True)

    @abc.abstractmethod
    def start(self, key: Key[Array, ""]) -> Pose:
        """A pose to start from."""

    @abc.abstractmethod
    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        """What happens when the robot drives from `start` through the poses of `path` (world frame)."""

    def reset(self, key: Key[Array, ""]) -> VehicleState:
        """The vehicle at a start."""
        return self.vehicle.reset(self.start(key))

    def prior(self, key: Key[Array, ""], world: VehicleState, num_samples: int) -> Pose:
        """The first reading."""
        del num_samples
        return self.vehicle.measure(key, world, self._noise)

    def execute(
        self, key: Key[Array, ""], world: VehicleState, path: Path
    ) -> tuple[VehicleState, Pose, Events]:
        """Drive a path from where the vehicle takes itself to be, and read the pose it ends in."""
        planned = place(path, self.vehicle.estimate(world))
        tracked = self.vehicle.follow(jax.random.fold_in(key, 0), world, planned, planned[-1], self._noise)
        outcome = self.outcome(self.pose(world), tracked.poses)
        index = jnp.arange(planned.shape[0], dtype=outcome.last.dtype)
        driven = tracked.poses[jnp.minimum(index, outcome.last)]
        events = Events(
            reward=outcome.reward,
            terminated=outcome.terminated,
            success=outcome.success,
            exited=outcome.exited,
            driven=driven,
            is_driven=index <= outcome.last,
            frames=tracked.frames,
            failed=tracked.failed,
        )
        state = self.vehicle.stopped_at(tracked.state, driven[-1])
        return state, self.vehicle.measure(key, state, self._noise), events

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

    def pose(self, world: VehicleState) -> Pose:
        """See `Problem`."""
        return self.vehicle.pose(world)

    @property
    def turning_radius(self) -> float:
        """See `Problem`."""
        return self.vehicle.turning_radius

    @property
    def reach(self) -> float:
        """See `Problem`."""
        return self.vehicle.reach

    @property
    def _noise(self) -> Float[Array, "3"]:
        return jnp.stack([self.position_noise, self.position_noise, self.heading_noise])
