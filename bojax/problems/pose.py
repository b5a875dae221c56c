"""Problems whose state is the pose of the robot, observed through a noisy measurement."""

import abc
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.models.checks import is_known
from bojax.motions.base import Path, Pose, place
from bojax.numerics.trial import Misfit, computed, is_users, require, trial, trial_of
from bojax.problems.base import Objective
from bojax.problems.path_problem import PathEvents, PathProblem, Simulation
from bojax.problems.vehicles.base import Exact, Vehicle, VehicleState

_NUM_STARTS, _NUM_POSES = 8, 10


class Outcome(eqx.Module):
    """Outcome of a path.

    Attributes:
        reward: Reward of the path.
        terminated: Whether the episode ends; only then may the robot stop before the end of the path.
        success: Whether the task is solved.
        exited: Whether the robot left the domain.
        last: Index of the last pose driven.
    """

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    success: Bool[Array, ""]
    exited: Bool[Array, ""]
    last: Int[Array, ""]


class PoseProblem(PathProblem):
    """A problem defined by its initial pose and the outcome of a path, which subclasses implement.

    The planner's model follows paths exactly. It observes the pose with Gaussian
    noise. Its belief is the last measurement, which simulations treat as the true pose. In the world, the
    `vehicle` follows the paths, by default exactly.

    Attributes:
        runs_in_kernels: Whether `outcome` also takes `Poses`, and can be computed in a kernel of Pallas, as
            `bojax.planning.cbts_kernel` does. There, the first pose of a path may be repeated, so that sums
            over the poses are wrong. A subclass has to say so again.
    """

    runs_in_kernels: ClassVar[bool] = False

    position_noise: eqx.AbstractVar[Float[Array, ""]]
    heading_noise: eqx.AbstractVar[Float[Array, ""]]
    vehicle: Vehicle = eqx.field(default_factory=Exact, kw_only=True)

    @override
    def __check_init__(self):
        """Call `start` and `outcome` of a user's problem, or raise ValueError."""
        key = jax.random.key(0)
        trial(self, _check_path, key)
        # While JAX traces anything, the key is traced too, and nothing can be computed.
        if is_users(self) and is_known((self, key)):
            with trial_of(type(self).__name__):
                _check_numbers(self)

    @abc.abstractmethod
    def start(self, key: Key[Array, ""]) -> Pose:
        """Initial pose."""

    @abc.abstractmethod
    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        """Outcome of driving from `start` through the poses of `path`, in the world frame."""

    @override
    def reset(self, key: Key[Array, ""]) -> VehicleState:
        return self.vehicle.reset(self.start(key))

    @override
    def prior(self, key: Key[Array, ""], world: VehicleState, num_samples: int) -> Pose:
        """The first measurement."""
        return self.vehicle.measure(key, world, self.reading_noise)

    @override
    def execute(
        self, key: Key[Array, ""], world: VehicleState, action: Path
    ) -> tuple[VehicleState, Pose, PathEvents]:
        """Drive a path from the vehicle's estimate of its pose, and measure the final pose.

        The outcome is that of the true poses, whatever was measured. The last one is the pose at rest, which
        all recorded data end with.
        """
        planned = place(action, self.vehicle.estimate(world))
        tracked = self.vehicle.follow(
            jax.random.fold_in(key, 0), world, planned, planned[-1], self.reading_noise
        )
        # A vehicle may pass the last pose of the path before it rests.
        poses = tracked.poses.at[-1].set(self.pose(tracked.state))
        outcome = self.outcome(self.pose(world), poses)
        state, last = self.vehicle.stopped_at(replace(tracked, poses=poses), outcome.last)
        index = jnp.arange(planned.shape[0], dtype=last.dtype)
        events = PathEvents(
            reward=outcome.reward,
            terminated=outcome.terminated,
            success=outcome.success,
            exited=outcome.exited,
            driven=poses[jnp.minimum(index, last)],
            is_driven=index <= last,
            frames=tracked.frames,
            failed=tracked.failed,
        )
        return state, self.vehicle.measure(key, state, self.reading_noise), events

    @override
    def update(
        self, belief: Pose, action: Path, observation: Pose, key: Key[Array, ""] | None = None
    ) -> Pose:
        """The last measurement."""
        return observation

    @override
    def root(self, belief: Pose, horizon: int) -> tuple[None, Pose]:
        return None, belief

    @override
    def simulate(
        self, key: Key[Array, ""], root: None, node: Pose, paths: Float[Array, "H S 3"], objective: Objective
    ) -> Simulation:
        """Drive the paths one after the other, without noise."""
        # The initial pose of each path depends only on the ends of the paths before it, so that all outcomes
        # are one batch. Those after termination are computed and ignored.
        starts = [node]
        for path in paths:
            starts.append(place(path[-1], starts[-1]))
        begin = jnp.stack(starts[:-1])
        outcome = jax.vmap(lambda start, path: self.outcome(start, place(path, start)))(begin, paths)
        return Simulation(starts[1], outcome.reward, outcome.terminated)

    @override
    def pose(self, world: VehicleState) -> Pose:
        return self.vehicle.pose(world)

    @property
    @override
    def turning_radius(self) -> float:
        return self.vehicle.turning_radius

    @property
    @override
    def reach(self) -> float:
        return self.vehicle.reach

    @property
    def reading_noise(self) -> Float[Array, "3"]:
        """Standard deviations of a measurement of the pose, m and rad."""
        return jnp.stack([self.position_noise, self.position_noise, self.heading_noise])


def _check_path(problem: PoseProblem, key: Key[Array, ""]) -> None:
    """Check the start, and the outcome of a path of two poses."""
    number, truth = jnp.zeros_like(problem.position_noise), jnp.zeros((), bool)
    pose = jnp.zeros(3, number.dtype)
    require("start", problem.start(key), pose)
    outcome = problem.outcome(pose, jnp.stack([pose, pose]))
    if not isinstance(outcome, Outcome):
        raise Misfit(f"outcome returns a {type(outcome).__name__}; allowed: an Outcome")
    require("Outcome.reward", outcome.reward, number)
    for name in ("terminated", "success", "exited"):
        require(f"Outcome.{name}", getattr(outcome, name), truth)
    if jnp.shape(outcome.last) != () or not jnp.issubdtype(jnp.result_type(outcome.last), jnp.integer):
        raise Misfit("Outcome.last is not one integer")


def _sample(problem: PoseProblem, key: Key[Array, ""]) -> tuple[Float[Array, "N 3"], Outcome]:
    """A few starts, and the outcome of driving 1 m straight ahead from each."""
    starts = jax.vmap(problem.start)(jax.random.split(key, _NUM_STARTS))
    path = jnp.zeros((_NUM_POSES, 3), starts.dtype).at[:, 0].set(jnp.arange(1, _NUM_POSES + 1) / _NUM_POSES)
    return starts, jax.vmap(lambda start: problem.outcome(start, place(path, start)))(starts)


def _check_numbers(problem: PoseProblem) -> None:
    """Refuse poses and rewards that are not finite, indices outside of the path, and impure methods."""
    starts, outcome = computed(_sample, problem)
    if not np.all(np.isfinite(starts)):
        raise Misfit("start: a pose is not finite")
    if not np.all(np.isfinite(outcome.reward)):
        raise Misfit("Outcome.reward is not finite")
    if np.any(is_off := (outcome.last < 0) | (outcome.last >= _NUM_POSES)):
        raise Misfit(
            f"Outcome.last is {outcome.last[is_off][0]} for a path of {_NUM_POSES} poses; allowed: from 0 to "
            f"{_NUM_POSES - 1}"
        )
