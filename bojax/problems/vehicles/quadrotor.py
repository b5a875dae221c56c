"""A quadrotor that flies planned paths at a constant altitude (thesis, Sections 3.5.1 and 3.5.2)."""

from math import sqrt

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.motions.base import Path, Pose
from bojax.numerics.angles import wrap_to_2pi
from bojax.problems.vehicles.base import PoseNoise, TrackingResult
from bojax.problems.vehicles.simulated import SimulatedState, SimulatedVehicle, frames_of, planar
from bojax.robots.flight import Airframe, control, reference_trajectory
from bojax.robots.models import packaged
from bojax.robots.quaternions import rotate_yaw, rotation_matrix
from bojax.robots.simulator import Physics, RobotState, Simulator

FRAME_EVERY = 10  # number of control steps between two frames of an animation


class Quadrotor(SimulatedVehicle):
    """A quadrotor that flies a path from rest to rest, then turns on the spot to the desired heading.

    MJX simulates the robot with a step of 10 ms, and the controller of `bojax.robots.flight` acts at every
    step. Position and heading are measured at every step (thesis: by PTAM on the frontal camera), the
    altitude with the noise of a horizontal coordinate. Velocities, roll and pitch, which a real robot has
    from inertial sensors, are known exactly.

    Settings: `bojax.problems.vehicles.settings.Quadrotor`.
    """

    altitude: Float[Array, ""]
    physics: Physics
    path_steps: int = eqx.field(static=True)
    rest_steps: int = eqx.field(static=True)

    @property
    @override
    def simulator(self) -> Simulator:
        return Simulator(self.physics, packaged("quadrotor"), 1)

    @property
    def airframe(self) -> Airframe:
        """Parameters of the controller, read from the model."""
        model = self.simulator.mujoco_model
        rotors = model.site_pos[model.actuator_trnid[:, 0]]
        yaw_ratio = model.actuator_gear[:, 5]
        allocation = np.stack([np.ones(4), rotors[:, 1], -rotors[:, 0], yaw_ratio])
        return Airframe(
            mass=_f32(model.body("quadrotor").mass[0]),
            inertia=_f32(model.body("quadrotor").inertia),
            gravity=_f32(-model.opt.gravity[2]),
            mixer=_f32(np.linalg.inv(allocation)),
            max_thrust=_f32(model.actuator_ctrlrange[0, 1]),
        )

    @override
    def reset(self, pose: Pose) -> SimulatedState:
        return self.at_rest(pose, self.altitude)

    @override
    def follow(
        self, key: Key[Array, ""], state: SimulatedState, path: Path, end: Pose, noise: PoseNoise
    ) -> TrackingResult:
        simulator, airframe = self.simulator, self.airframe
        num_steps = self.path_steps + self.rest_steps
        reference, at = reference_trajectory(
            state.reading.astype(jnp.float32),
            path.astype(jnp.float32),
            end[2].astype(jnp.float32),
            self.altitude.astype(jnp.float32),
            simulator.time_step,
            self.path_steps,
            self.rest_steps,
        )
        errors = jnp.zeros((num_steps + 1, 4), jnp.float32)
        if noise is not None:
            # The altitude is measured with the noise of a horizontal coordinate.
            spread = noise[jnp.asarray([0, 1, 0, 2])].astype(jnp.float32)
            errors = spread[None] * jax.random.normal(key, errors.shape, jnp.float32)

        def fly(robot: RobotState, now):
            reference, error = now
            position = robot.qpos[:3] + error[:3]
            rotation = rotation_matrix(rotate_yaw(robot.qpos[3:], error[3]))
            thrusts = control(airframe, reference, position, robot.qvel[:3], rotation, robot.qvel[3:])
            return simulator.advance(robot, thrusts), robot.qpos

        robot, flown = jax.lax.scan(fly, state.robot, (reference, errors[:-1]))
        flown = jnp.concatenate([flown, robot.qpos[None]])
        poses = jax.vmap(planar)(flown)
        readings = poses + errors[:, jnp.asarray([0, 1, 3])]
        reading = readings[-1].at[2].set(wrap_to_2pi(readings[-1, 2]))
        dtype = path.dtype
        return TrackingResult(
            state=SimulatedState(robot, reading.astype(dtype)),
            poses=poses[at].astype(dtype),
            estimates=readings[at].astype(dtype),
            sensor_poses=jax.vmap(self._sensor_pose)(flown[at]).astype(dtype),
            frames=frames_of(flown, FRAME_EVERY),
            failed=simulator.has_diverged(robot),
        )

    @property
    @override
    def reach(self) -> float:
        """Length of the minimum-jerk flight from rest to rest that takes full thrust at constant altitude."""
        # The largest acceleration of such a flight is 10 / sqrt(3) times its length over its squared
        # duration.
        airframe = self.airframe
        upward = 4.0 * float(airframe.max_thrust) / float(airframe.mass)
        sideways = sqrt(upward**2 - float(airframe.gravity) ** 2)
        return sideways * (self.path_steps * self.simulator.time_step) ** 2 * sqrt(3.0) / 10.0

    @property
    @override
    def flight_altitude(self) -> float:
        return float(self.altitude)

    def _sensor_pose(self, qpos: Float[Array, "7"]) -> Float[Array, "7"]:
        below = _f32(self.simulator.mujoco_model.site("range").pos)
        turned_below = jnp.sum(rotation_matrix(qpos[3:]) * below[None], axis=1)
        return jnp.concatenate([qpos[:3] + turned_below, qpos[3:]])


def _f32(value) -> Float[Array, "..."]:
    return jnp.asarray(value, jnp.float32)
