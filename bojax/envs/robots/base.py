"""What the robots that are learned on share."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from bojax.envs.base import EnvState
from bojax.envs.control import ControlTask
from bojax.envs.spaces import Box
from bojax.robots.models import RobotModel
from bojax.robots.simulator import Physics, Simulator


class RobotTask(ControlTask):
    """A control task of a robot that MJX steps; a subclass says where it starts and what is seen and paid.

    Actions are the model's controls, within its ranges. A state that the simulation cannot have reached
    soundly pays NaN, which ends the run as failed. A state is that of the simulator, unless a subclass adds
    to it what does not move.

    Attributes:
        physics: How MJX computes.
        substeps: Steps of the physics for one action.
    """

    physics: eqx.AbstractVar[Physics]
    substeps: eqx.AbstractVar[int]

    def __check_init__(self):
        """Look at the model before anything runs; see also `Simulator`.

        Raises:
            ValueError: MuJoCo or MJX refuse it, or an actuator has no `ctrlrange`, which bounds actions.
        """
        model = self.simulator.mujoco_model
        # MuJoCo has (0, 0) where there is none: all actions would be clipped to 0.
        low, high = model.actuator_ctrlrange.T
        free = [model.actuator(number).name or str(number) for number in (low >= high).nonzero()[0]]
        if free:
            raise ValueError(f"model: actions have no bounds: no ctrlrange of actuators {', '.join(free)}")

    @property
    @abc.abstractmethod
    def model(self) -> RobotModel:
        """The robot and its world."""

    @property
    def simulator(self) -> Simulator:
        """The physics."""
        return Simulator(self.physics, self.model, self.substeps)

    @property
    def action_space(self) -> Box:
        """The controls of the model, in its order."""
        ranges = jnp.asarray(self.simulator.mujoco_model.actuator_ctrlrange, self.dtype)
        return Box(ranges[:, 0], ranges[:, 1])

    @property
    def dtype(self) -> jnp.dtype:
        """Precision of observations and rewards; the physics itself has 32 bits."""
        return self.physics.max_speed.dtype

    def advance(self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]) -> EnvState:
        """See `ControlTask`; nothing is random."""
        del key
        return self.simulator.advance(state, action)

    def has_diverged(self, state: EnvState) -> Bool[Array, ""]:
        """See `ControlTask`."""
        return self.simulator.has_diverged(state)

    def frame(self, state: EnvState) -> Float[Array, "Q"]:
        """The positions, and behind them those of the model's mocap bodies where it has some."""
        return state.qpos
