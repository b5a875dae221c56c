"""A wheeled robot that drives forward only and tracks planned paths by pure pursuit (thesis, p. 101)."""

from math import log

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.motions.base import Pose
from bojax.problems.vehicles.base import Ride
from bojax.problems.vehicles.simulated import SimulatedBody, SimulatedVehicle, planar
from bojax.robots import pursuit
from bojax.robots.car import Measures, car_model, measures_of
from bojax.robots.pursuit import PIECES, Route
from bojax.robots.simulator import Physics, Simulator

FRAME_EVERY = 2
"""Readings between two frames of an animation."""

LEFT = 0.01
"""What may be left of a path at the end of its time, in metres."""


class WheeledRobot(SimulatedVehicle):
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

    @property
    def simulator(self) -> Simulator:
        """The physics."""
        return Simulator(self.physics, car_model(), self.substeps)

    @property
    def measures(self) -> Measures:
        """The measures of the robot."""
        return measures_of(self.simulator.mujoco_model)

    def place(self, pose: Pose) -> SimulatedBody:
        """See `Vehicle`."""
        return self.at_rest(pose, jnp.asarray(self.simulator.mujoco_model.qpos0[2]))

    def follow(
        self,
        key: Key[Array, ""],
        body: SimulatedBody,
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
            return (after, planar(after.qpos) + error, passed), (state.qpos, reading, passed)

        carry = (body.state, start, jnp.zeros((), jnp.int32))
        (state, reading, _), (driven, readings, passed) = jax.lax.scan(drive, carry, errors)
        driven = jnp.concatenate([driven, state.qpos[None]])
        readings = jnp.concatenate([readings, reading[None]])
        at = self._reached(passed, path.shape[0])
        return Ride(
            body=SimulatedBody(state, reading.astype(path.dtype)),
            poses=jax.vmap(planar)(driven[at]).astype(path.dtype),
            estimates=readings[at].astype(path.dtype),
            frames=driven[FRAME_EVERY::FRAME_EVERY],
            failed=simulator.has_diverged(state),
        )

    @property
    def turning_radius(self) -> float:
        """See `Vehicle`."""
        return self.measures.turning_radius

    @property
    def reach(self) -> float:
        """See `Vehicle`: how far it drives until 1 cm of the path is left, where the path is long.

        It drives at `speed` until `speed / gain` is left, and from there on slower and slower.
        """
        speed, slow = float(self.speed), float(self.speed) / float(self.gain)
        seconds = self.readings * self.simulator.time_step
        return max(0.0, speed * (seconds - log(max(1.0, slow / LEFT)) / float(self.gain)) + max(slow, LEFT))

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
