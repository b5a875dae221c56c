"""A quadrotor that flies planned paths at a constant altitude (thesis, Sections 3.5.1 and 3.5.2)."""

from math import sqrt

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.numerics.angles import wrap_to_2pi
from bojax.problems.vehicles.base import Ride
from bojax.problems.vehicles.simulated import SimulatedBody, SimulatedVehicle, planar
from bojax.robots.flight import Airframe, control, way
from bojax.robots.quadrotor import quadrotor_model
from bojax.robots.quaternions import rotation_of, turned
from bojax.robots.simulator import Physics, RobotState, Simulator

FRAME_EVERY = 10
"""Control steps between two frames of an animation."""


class Quadrotor(SimulatedVehicle):
    """Flies a path from rest to rest, and then turns on the spot to the heading wanted there.

    MJX steps the robot, the controller of `bojax.robots.flight` steers it, once a step of the physics of
    10 ms. Position and heading are known by a reading each step (thesis: PTAM on the frontal camera), the
    altitude with the noise of a horizontal coordinate; velocities, roll and pitch, which are those of
    inertial sensors, are known exactly.

    Attributes:
        altitude: Altitude of flight, in metres.
        physics: How MJX computes.
        path_steps: Steps of the physics for a path.
        rest_steps: Steps of the physics after it, to turn and to come to rest.
    """

    altitude: Float[Array, ""]
    physics: Physics
    path_steps: int = eqx.field(static=True)
    rest_steps: int = eqx.field(static=True)

    @property
    def simulator(self) -> Simulator:
        """The physics."""
        return Simulator(self.physics, quadrotor_model(), 1)

    @property
    def airframe(self) -> Airframe:
        """What the controller knows, from the model."""
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

    def place(self, pose: Pose) -> SimulatedBody:
        """See `Vehicle`: hovering."""
        return self.at_rest(pose, self.altitude)

    def follow(
        self,
        key: Key[Array, ""],
        body: SimulatedBody,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> Ride:
        """See `Vehicle`."""
        simulator, airframe = self.simulator, self.airframe
        num_steps = self.path_steps + self.rest_steps
        reference, at = way(
            body.reading.astype(jnp.float32),
            path.astype(jnp.float32),
            end[2].astype(jnp.float32),
            self.altitude.astype(jnp.float32),
            simulator.time_step,
            self.path_steps,
            self.rest_steps,
        )
        errors = jnp.zeros((num_steps + 1, 4), jnp.float32)
        if noise is not None:
            spread = noise[jnp.asarray([0, 1, 0, 2])].astype(jnp.float32)
            errors = spread[None] * jax.random.normal(key, errors.shape, jnp.float32)

        def fly(state: RobotState, now):
            reference, error = now
            position = state.qpos[:3] + error[:3]
            rotation = rotation_of(turned(state.qpos[3:], error[3]))
            thrusts = control(airframe, reference, position, state.qvel[:3], rotation, state.qvel[3:])
            return simulator.advance(state, thrusts), state.qpos

        state, flown = jax.lax.scan(fly, body.state, (reference, errors[:-1]))
        flown = jnp.concatenate([flown, state.qpos[None]])
        poses = jax.vmap(planar)(flown)
        readings = poses + errors[:, jnp.asarray([0, 1, 3])]
        reading = readings[-1].at[2].set(wrap_to_2pi(readings[-1, 2]))
        dtype = path.dtype
        return Ride(
            body=SimulatedBody(state, reading.astype(dtype)),
            poses=poses[at].astype(dtype),
            estimates=readings[at].astype(dtype),
            mounts=jax.vmap(self._mount)(flown[at]).astype(dtype),
            frames=flown[FRAME_EVERY::FRAME_EVERY],
            failed=simulator.has_diverged(state),
        )

    @property
    def reach(self) -> float:
        """See `Vehicle`: what full thrust carries at this altitude, from rest to rest with the least jerk.

        Its largest acceleration is 10 / sqrt(3) times the length over the square of the time.
        """
        airframe = self.airframe
        upward = 4.0 * float(airframe.max_thrust) / float(airframe.mass)
        sideways = sqrt(upward**2 - float(airframe.gravity) ** 2)
        return sideways * (self.path_steps * self.simulator.time_step) ** 2 * sqrt(3.0) / 10.0

    @property
    def flight_altitude(self) -> float:
        """See `Vehicle`."""
        return float(self.altitude)

    def _mount(self, qpos: Float[Array, "7"]) -> Float[Array, "7"]:
        below = _f32(self.simulator.mujoco_model.site("range").pos)
        turned_below = jnp.sum(rotation_of(qpos[3:]) * below[None], axis=1)
        return jnp.concatenate([qpos[:3] + turned_below, qpos[3:]])


def _f32(value) -> Float[Array, "..."]:
    return jnp.asarray(value, jnp.float32)
