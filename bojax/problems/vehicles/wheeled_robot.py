"""A wheeled robot that drives forward only and tracks planned paths by pure pursuit (thesis, p. 101)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.motions.base import Pose
from bojax.problems.vehicles.base import Ride, Vehicle
from bojax.robots import pursuit
from bojax.robots.car import Measures, car_model, measures_of
from bojax.robots.flight import yaw_of
from bojax.robots.pursuit import PIECES, Route
from bojax.robots.simulator import Physics, RobotState, Simulator

FRAME_EVERY = 2
"""Readings between two frames of an animation."""


class Driven(eqx.Module):
    """The robot between two paths.

    Attributes:
        state: Its true state.
        reading: The last reading of its pose.
    """

    state: RobotState
    reading: Pose


class WheeledRobot(Vehicle):
    """Drives along a path at a constant speed, slows down before its end, and waits there.

    MJX steps the robot; a pose is that of the middle of its rear axle, which moves along its heading. It
    takes its pose to be the last reading of a tracking system, once every `substeps` steps of the physics
    of 10 ms, and steers by pure pursuit of the path as it was placed at the first of them. Every path takes
    the same time; a robot that has not come to its end by then stays where it is, and may still roll.

    The poses of a ride are those at the readings by which the robot has passed a pose of the path, the last
    one that in which it ends. It cannot turn on the spot, so that the heading wanted at the end does not
    matter.

    Attributes:
        look_ahead: How far ahead on the path the point lies that it steers for, in metres.
        speed: Speed in m/s.
        gain: Speed for each metre left, in 1/s; what makes it stop.
        physics: How MJX computes.
        substeps: Steps of the physics between two readings.
        readings: Readings while it follows a path.
    """

    look_ahead: Float[Array, ""]
    speed: Float[Array, ""]
    gain: Float[Array, ""]
    physics: Physics
    substeps: int = eqx.field(static=True)
    readings: int = eqx.field(static=True)

    def __check_init__(self):
        """See `Simulator`."""
        _ = self.simulator

    @property
    def simulator(self) -> Simulator:
        """The physics."""
        return Simulator(self.physics, car_model(), self.substeps)

    @property
    def measures(self) -> Measures:
        """The measures of the robot."""
        return measures_of(self.simulator.mujoco_model)

    def place(self, pose: Pose) -> Driven:
        """See `Vehicle`."""
        rest = jnp.asarray(self.simulator.mujoco_model.qpos0, pose.dtype)
        zero, half = jnp.zeros((), pose.dtype), 0.5 * pose[2]
        turned = jnp.stack([jnp.cos(half), zero, zero, jnp.sin(half)])
        qpos = jnp.concatenate([pose[:2], rest[2:3], turned, rest[7:]])
        velocity = jnp.zeros((self.simulator.mujoco_model.nv,), jnp.float32)
        return Driven(self.simulator.state(qpos, velocity), pose)

    def pose(self, body: Driven) -> Pose:
        """See `Vehicle`."""
        return _pose(body.state.qpos).astype(body.reading.dtype)

    def estimate(self, body: Driven) -> Pose:
        """The last reading."""
        return body.reading

    def follow(
        self,
        key: Key[Array, ""],
        body: Driven,
        path: Float[Array, "S 3"],
        end: Pose,
        noise: Float[Array, "3"] | None,
    ) -> Ride:
        """See `Vehicle`."""
        del end
        simulator = self.simulator
        errors = jnp.zeros((self.readings, 3), jnp.float32)
        if noise is not None:
            errors = noise[None].astype(jnp.float32) * jax.random.normal(key, errors.shape, jnp.float32)
        # All of this is in 32 bits, as the physics is, whatever the precision of the plans.
        start = body.reading.astype(jnp.float32)
        route = pursuit.route(start, path.astype(jnp.float32))

        def drive(carry, error):
            state, reading, passed = carry
            controls, passed = self._controls(route, reading, passed)
            after = simulator.advance(state, controls)
            return (after, _pose(after.qpos) + error, passed), (state.qpos, reading, passed)

        carry = (body.state, start, jnp.zeros((), jnp.int32))
        (state, reading, _), (driven, readings, passed) = jax.lax.scan(drive, carry, errors)
        driven = jnp.concatenate([driven, state.qpos[None]])
        readings = jnp.concatenate([readings, reading[None]])
        at = self._reached(passed, path.shape[0])
        return Ride(
            body=Driven(state, reading.astype(path.dtype)),
            poses=jax.vmap(_pose)(driven[at]).astype(path.dtype),
            estimates=readings[at].astype(path.dtype),
            frames=driven[FRAME_EVERY::FRAME_EVERY],
            failed=simulator.has_diverged(state),
        )

    @property
    def frame_shape(self) -> tuple[int, int]:
        """See `Vehicle`."""
        return self.readings // FRAME_EVERY, int(self.simulator.mujoco_model.nq)

    @property
    def turning_radius(self) -> float:
        """See `Vehicle`."""
        return self.measures.turning_radius

    def _controls(
        self, route: Route, reading: Float[Array, "3"], passed: Int[Array, ""]
    ) -> tuple[Float[Array, "3"], Int[Array, ""]]:
        """Angles of the front wheels and the share of full speed; the point of the route that is passed."""
        wheelbase, half_track, sharpest, full_speed, look_ahead, speed, gain = (
            jnp.asarray(number, jnp.float32)
            for number in (
                self.measures.wheelbase,
                self.measures.half_track,
                1.0 / self.turning_radius,
                self.measures.full_speed,
                self.look_ahead,
                self.speed,
                self.gain,
            )
        )
        passed = route.nearest(reading[:2], passed, look_ahead)
        here = route.arc[passed]
        curvature = jnp.clip(pursuit.curvature(reading, route.at(here + look_ahead)), -sharpest, sharpest)
        angles = pursuit.wheel_angles(curvature, wheelbase, half_track)
        speed = jnp.minimum(speed, gain * (route.length - here))
        return jnp.concatenate([angles, (speed / full_speed)[None]]), passed

    def _reached(self, passed: Int[Array, "N"], num_poses: int) -> Int[Array, "S"]:
        """At which reading each pose of the path is passed; after all of them at the end, or if never."""
        points = PIECES * jnp.arange(1, num_poses + 1, dtype=passed.dtype)
        has_passed = passed[None] >= points[:, None]
        first = jnp.argmax(has_passed, axis=1).astype(passed.dtype)
        last = jnp.asarray(self.readings, passed.dtype)
        return jnp.where(has_passed[:, -1], first, last).at[-1].set(last)


def _pose(qpos: Float[Array, "Q"]) -> Float[Array, "3"]:
    """Position and heading in metres and rad, in [0, 2 pi)."""
    return jnp.concatenate([qpos[:2], jnp.mod(yaw_of(qpos[3:7]), 2.0 * jnp.pi)[None]])
