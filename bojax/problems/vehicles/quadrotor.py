"""A quadrotor that flies planned paths at a constant altitude (thesis, Sections 3.5.1 and 3.5.2)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.problems.vehicles.base import Ride, Vehicle
from bojax.robots.flight import Airframe, control, rotation_of, turned, way, yaw_of
from bojax.robots.quadrotor import quadrotor_model
from bojax.robots.simulator import Physics, RobotState, Simulator

FRAME_EVERY = 10
"""Control steps between two frames of an animation."""


class Hover(eqx.Module):
    """The quadrotor between two paths.

    Attributes:
        state: Its true state.
        reading: The last reading of its pose.
    """

    state: RobotState
    reading: Pose


class Quadrotor(Vehicle):
    """Flies a path from rest to rest, and then turns on the spot to the heading wanted there.

    MJX steps the robot, the controller of `bojax.robots.flight` steers it, once a step of the physics of
    10 ms. Position and heading are known by a reading each step (thesis: PTAM on the frontal camera), the
    altitude with the noise of a horizontal coordinate; velocities, roll and pitch, which are those of
    inertial sensors, are known exactly. What it takes its pose to be is the last reading, not a filter's
    estimate.

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

    def __check_init__(self):
        """See `Simulator`."""
        _ = self.simulator

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

    def place(self, pose: Pose) -> Hover:
        """See `Vehicle`: hovering."""
        level = jnp.asarray([1.0, 0.0, 0.0, 0.0], pose.dtype)
        qpos = jnp.concatenate([pose[:2], self.altitude[None], turned(level, pose[2])])
        return Hover(self.simulator.state(qpos, jnp.zeros((6,), jnp.float32)), pose)

    def pose(self, body: Hover) -> Pose:
        """See `Vehicle`."""
        return _pose(body.state.qpos).astype(body.reading.dtype)

    def estimate(self, body: Hover) -> Pose:
        """The last reading."""
        return body.reading

    def follow(
        self,
        key: Key[Array, ""],
        body: Hover,
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
        poses = jax.vmap(_pose)(flown)
        readings = poses + errors[:, jnp.asarray([0, 1, 3])]
        reading = readings[-1].at[2].set(jnp.mod(readings[-1, 2], 2.0 * jnp.pi))
        dtype = path.dtype
        return Ride(
            body=Hover(state, reading.astype(dtype)),
            poses=poses[at].astype(dtype),
            estimates=readings[at].astype(dtype),
            mounts=jax.vmap(self._mount)(flown[at]).astype(dtype),
            frames=flown[FRAME_EVERY::FRAME_EVERY],
            failed=simulator.has_diverged(state),
        )

    @property
    def frame_shape(self) -> tuple[int, int]:
        """See `Vehicle`: position and orientation of the body, 10 times a second."""
        return (self.path_steps + self.rest_steps) // FRAME_EVERY, 7

    def _mount(self, qpos: Float[Array, "7"]) -> Float[Array, "7"]:
        below = _f32(self.simulator.mujoco_model.site("range").pos)
        turned_below = jnp.sum(rotation_of(qpos[3:]) * below[None], axis=1)
        return jnp.concatenate([qpos[:3] + turned_below, qpos[3:]])


def _pose(qpos: Float[Array, "7"]) -> Float[Array, "3"]:
    """Position and heading of the body, in metres and rad, in [0, 2 pi)."""
    return jnp.concatenate([qpos[:2], jnp.mod(yaw_of(qpos[3:]), 2.0 * jnp.pi)[None]])


def _f32(value) -> Float[Array, "..."]:
    return jnp.asarray(value, jnp.float32)
