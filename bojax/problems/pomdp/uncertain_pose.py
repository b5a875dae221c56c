"""A problem of a robot's pose as a state problem: a search may branch on what it would measure."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float, Key, Scalar
from typing_extensions import override

from bojax.motions.base import ContinuousMotions, Pose, place
from bojax.problems import particles
from bojax.problems.actions import Box
from bojax.problems.particles import Particles
from bojax.problems.pose import Outcome, PoseProblem
from bojax.problems.state_space import Sketch, StateProblem
from bojax.problems.vehicles.base import Exact
from bojax.results.outline import Outline
from bojax.results.schema import Column, Table

LEAST_NOISE = 1e-3
"""Smallest standard deviation of a measurement in its likelihood, m and rad."""


class UncertainPose(StateProblem):
    """A `PoseProblem` whose pose is believed as particles, and whose actions are parameters of a path.

    The state is the pose, whose heading is not wrapped; a path is driven exactly from the true pose, and pays
    the outcome of the pose problem. Every path is followed by a measurement of the pose, with the noise of
    that problem. The initial belief is the posterior after a first measurement, for a start that is uniform
    on the poses at which an episode can be; the planners of paths take that measurement for the pose itself.

    Settings: `bojax.problems.pomdp.settings.UncertainPose`.
    """

    problem: PoseProblem  # the pose problem; its vehicle follows paths exactly
    motions: ContinuousMotions  # family of paths
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True, init=False)

    def __post_init__(self) -> None:
        self.max_steps = self.problem.max_steps

    @override
    def __check_init__(self):
        super().__check_init__()
        name = type(self.problem).__name__
        if not isinstance(self.problem, PoseProblem):
            raise ValueError(f"problem: got {name}; allowed: a problem of the robot's pose, as parking")
        if not isinstance(self.problem.vehicle, Exact):
            vehicle = type(self.problem.vehicle).__name__
            raise ValueError(f"problem.vehicle: got {vehicle}; allowed: exact, which follows paths exactly")

    @property
    @override
    def actions(self) -> Box:
        one = jnp.ones(self.motions.num_params, self.discount.dtype)
        return Box(-one, one)

    @override
    def initial(self, key: Key[Array, ""]) -> Pose:
        return self.problem.start(key)

    @override
    def step(
        self, key: Key[Array, ""], state: Pose, action: Float[Array, "K"]
    ) -> tuple[Pose, Float[Array, ""], Bool[Array, ""]]:
        path = place(self.motions.path(action), state)
        outcome = self.problem.outcome(state, path)
        return path[outcome.last], outcome.reward, outcome.terminated

    @override
    def observe(
        self, key: Key[Array, ""], state: Pose, action: Float[Array, "K"], next_state: Pose
    ) -> Float[Array, "3"]:
        return next_state + self.problem.reading_noise * jax.random.normal(key, (3,), next_state.dtype)

    @override
    def log_likelihood(
        self, observation: Float[Array, "3"], state: Pose, action: Float[Array, "K"], next_state: Pose
    ) -> Float[Array, ""]:
        return jnp.sum(
            norm.logpdf(observation, next_state, jnp.maximum(self.problem.reading_noise, LEAST_NOISE))
        )

    @override
    def prior(self, key: Key[Array, ""], world: Pose, num_samples: int) -> Particles:
        """Poses about a first measurement, without those at which an episode would have ended."""
        key_measure, key_spread, key_resample = jax.random.split(key, 3)
        measured = world + self.problem.reading_noise * jax.random.normal(key_measure, (3,), world.dtype)
        spread = jax.random.normal(key_spread, (self.num_particles, 3), world.dtype)
        poses = measured[None] + self.problem.reading_noise[None] * spread
        ended = jax.vmap(self._at_rest)(poses).terminated
        weights = jnp.where(ended & ~jnp.all(ended), -jnp.inf, 0.0).astype(world.dtype)
        indices = particles.systematic(key_resample, weights)
        equal = jnp.full((self.num_particles,), -jnp.log(self.num_particles), world.dtype)
        return Particles(poses[indices], equal, jnp.zeros_like(ended)).counted()

    @property
    @override
    def run_columns(self) -> Table:
        return (*super().run_columns, _SUCCESS)

    @override
    def row(self, world: Pose) -> dict[str, Scalar]:
        return dict(zip(("x", "y", "heading"), world, strict=True))

    @override
    def summary(self, record: Sketch, world: Pose, belief: Particles) -> dict[str, Scalar]:
        return super().summary(record, world, belief) | {"success": self._at_rest(world).success}

    @override
    def sketch(self, state: Pose) -> dict[str, Float[Array, "2"]]:
        return {"robot": state[:2]}

    @override
    def outline(self) -> Outline | None:
        return self.problem.outline()

    def _at_rest(self, pose: Pose) -> Outcome:
        """The outcome of standing at a pose."""
        return self.problem.outcome(pose, jnp.stack([pose, pose]))


_SUCCESS = Column("success", "bool", "", "the task is solved at the last pose")
