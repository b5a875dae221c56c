"""The common part of environments of simulated robots."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.base import EnvState
from bojax.envs.control import ControlTask
from bojax.envs.spaces import Box
from bojax.robots.models import RobotModel
from bojax.robots.simulator import RobotState, Simulated, Simulator


class RobotTask(Simulated, ControlTask):
    """A control task of a robot that MJX simulates.

    Subclasses define the initial state, the observations and the rewards. Actions are the controls of the
    model, within their ranges. A diverged simulation pays NaN, which ends the run as failed. By default,
    the state is the state of the robot; a subclass that adds to it overrides `robot` and `moved`.
    """

    substeps: int = eqx.field(static=True)

    def __check_init__(self):
        """Compile the model and check its actuators, see also `Simulator`.

        Raises:
            ValueError: MuJoCo or MJX refuse the model, or an actuator has no `ctrlrange`, which bounds
            actions.
        """
        model = self.simulator.mujoco_model
        # A missing range is (0, 0) in MuJoCo: all actions would be clipped to 0.
        low, high = model.actuator_ctrlrange.T
        free = [model.actuator(number).name or str(number) for number in (low >= high).nonzero()[0]]
        if free:
            raise ValueError(f"model: actions have no bounds: no ctrlrange of actuators {', '.join(free)}")

    @property
    @abc.abstractmethod
    def model(self) -> RobotModel:
        """The robot and its world."""

    @property
    @override
    def simulator(self) -> Simulator:
        return Simulator(self.physics, self.model, self.substeps)

    @property
    @override
    def action_space(self) -> Box:
        """The controls of the model, in the order of its actuators."""
        ranges = jnp.asarray(self.simulator.mujoco_model.actuator_ctrlrange, self.dtype)
        return Box(ranges[:, 0], ranges[:, 1])

    @property
    def dtype(self) -> jnp.dtype:
        """Precision of observations and rewards; the simulation runs in 32 bits."""
        return self.physics.max_speed.dtype

    def robot(self, state: EnvState) -> RobotState:
        """State of the robot within a state of the environment, by default all of it."""
        return state

    def moved(self, state: EnvState, robot: RobotState) -> EnvState:
        """The state of the environment after the robot has moved."""
        del state
        return robot

    def mocap_positions(self, state: EnvState) -> Float[Array, "M"] | None:
        """Positions of the model's mocap bodies, for an animation; None for a model without any."""
        del state
        return None

    @override
    def advance(self, key: Key[Array, ""], state: EnvState, action: Float[Array, "A"]) -> EnvState:
        del key
        return self.moved(state, self.simulator.advance(self.robot(state), action))

    @override
    def has_diverged(self, state: EnvState) -> Bool[Array, ""]:
        return self.simulator.has_diverged(self.robot(state))

    @override
    def frame(self, state: EnvState) -> Float[Array, "Q"]:
        """Generalised positions, followed by the positions of the mocap bodies if there are any.

        Raises:
            ValueError: `mocap_positions` has another length than the model needs.
        """
        qpos, mocap = self.robot(state).qpos, self.mocap_positions(state)
        needed = 3 * self.simulator.mujoco_model.nmocap
        if mocap is not None and mocap.shape != (needed,):
            raise ValueError(f"mocap_positions has the shape {mocap.shape}; the model needs ({needed},)")
        return qpos if mocap is None else jnp.concatenate([qpos, mocap.astype(jnp.float32)])
