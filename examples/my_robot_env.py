"""A robot of my own as an environment: push a puck across an air table into a pocket."""

from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

import bojax
from bojax.engine.training import train
from bojax.envs.control import ControlStep
from bojax.envs.robots.base import RobotTask
from bojax.envs.robots.settings import Robot
from bojax.envs.spaces import Box
from bojax.robots.models import RobotModel, from_file
from bojax.robots.simulator import Physics, RobotState

POCKET = 0.6, 0.6  # m


class AirTable(RobotTask):
    """Actions are the controls of the model; the goal is the pocket, at any speed."""

    class Config(Robot, frozen=True):
        """Settings: those of every robot (`physics`, `reward`, `max_steps`), and the following."""

        pocket_radius: float = 0.2
        substeps: int = 5

    pocket_radius: Float[Array, ""]  # m
    physics: Physics
    substeps: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    reward: Literal["goal-only", "classic"] = eqx.field(static=True)

    @property
    def model(self) -> RobotModel:
        """The MJCF file beside this module."""
        return from_file(Path(__file__).with_suffix(".xml"))

    @property
    def observation_space(self) -> Box:
        """Position in m and velocity in m/s."""
        high = jnp.asarray([1.0, 1.0, 2.0, 2.0], self.dtype)
        return Box(-high, high)

    def reset(self, key: Key[Array, ""]) -> RobotState:
        """The puck at rest in the opposite corner."""
        qpos = jax.random.uniform(key, (2,), jnp.float32, -0.8, -0.6)
        return self.simulator.state(qpos, jnp.zeros_like(qpos))

    def observe(self, state: RobotState) -> Float[Array, "4"]:
        """Position and velocity."""
        return jnp.concatenate([state.qpos, state.qvel]).astype(self.dtype)

    def is_goal(self, state: RobotState) -> Bool[Array, ""]:
        """Whether the puck is in the pocket."""
        return self.distance(state) < self.pocket_radius

    def distance(self, state: RobotState) -> Float[Array, ""]:
        """Distance to the pocket in m, in the precision of the experiment; the physics has 32 bits."""
        away = state.qpos.astype(self.dtype) - jnp.asarray(POCKET, self.dtype)
        return jnp.sqrt(jnp.sum(away**2))

    def classic(self, step: ControlStep):
        """Reward of a step, and whether the step ends the episode, if `reward` is "classic"."""
        return -self.distance(step.after), step.success


if __name__ == "__main__":
    env = AirTable(
        pocket_radius=jnp.asarray(0.2, jnp.float32),
        physics=bojax.part("mjx"),
        substeps=5,
        max_steps=100,
        reward="goal-only",
    )
    learner = {"kind": "emu-q", "features": {"num_features": 100, "action_lengthscale": 1.0}}
    training = train(env, learner, episodes=5, runs=4)
    print("episodes to the pocket:", training.runs["episodes_to_goal"].to_pylist())
