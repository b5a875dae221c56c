"""A wheeled robot that drives forward only and tracks planned paths by pure pursuit (thesis, p. 101)."""

from math import log

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import Path, Pose
from bojax.problems.vehicles.base import PoseNoise, TrackingResult
from bojax.problems.vehicles.simulated import SimulatedState, SimulatedVehicle, frames_of, planar
from bojax.robots import pursuit
from bojax.robots.models import packaged
from bojax.robots.pursuit import PIECES, CarParameters, Route, car_parameters
from bojax.robots.simulator import Physics, Simulator

FRAME_EVERY = 2  # number of measurements between two frames of an animation
STOPPING_DISTANCE = 0.01  # distance from the end of a path at which the path counts as completed, in metres


class WheeledRobot(SimulatedVehicle):
    """A car that drives along a path at constant speed, slows down before the end, and stops.

    MJX simulates the robot with a step of 10 ms. Its position is the midpoint of the rear axle, which moves
    along the heading. A tracking system measures the pose every `substeps` simulation steps; the robot steers
    by pure pursuit of the path, which is placed at the first measurement. Every path takes the same time:
    `readings` measurements, then `rest_readings` measurements without drive, in which the robot comes to rest
    even if it has not completed the path.

    The tracked poses are those at the first measurement at which the robot has passed the corresponding pose
    of the path; the last one is the final pose. The robot cannot turn on the spot: the desired final heading
    has no effect.

    Settings: `bojax.problems.vehicles.settings.WheeledRobot`.
    """

    look_ahead: Float[Array, ""]
    speed: Float[Array, ""]
    gain: Float[Array, ""]
    physics: Physics
    substeps: int = eqx.field(static=True)
    readings: int = eqx.field(static=True)
    rest_readings: int = eqx.field(static=True)

    @property
    @override
    def simulator(self) -> Simulator:
        return Simulator(self.physics, packaged("car"), self.substeps)

    @property
    def parameters(self) -> CarParameters:
        """Parameters of the controller, read from the model."""
        return car_parameters(self.simulator.mujoco_model)

    @override
    def reset(self, pose: Pose) -> SimulatedState:
        return self.at_rest(pose, jnp.asarray(self.simulator.mujoco_model.qpos0[2]))

    @override
    def follow(
        self, key: Key[Array, ""], state: SimulatedState, path: Path, end: Pose, noise: PoseNoise
    ) -> TrackingResult:
        simulator = self.simulator
        num_readings = self.readings + self.rest_readings
        errors = jnp.zeros((num_readings, 3), jnp.float32)
        if noise is not None:
            errors = noise[None].astype(jnp.float32) * jax.random.normal(key, errors.shape, jnp.float32)
        # The controller runs in 32 bits like the simulation, whatever the precision of the plans.
        start = state.reading.astype(jnp.float32)
        route = pursuit.route(start, path.astype(jnp.float32))

        def drive(carry, now):
            robot, reading, passed = carry
            error, is_driving = now
            controls, passed = self._controls(route, reading, passed)
            controls = jnp.where(is_driving, controls, controls.at[-1].set(0.0))
            after = simulator.advance(robot, controls)
            return (after, planar(after.qpos) + error, passed), (robot.qpos, reading, passed)

        carry = (state.robot, start, jnp.zeros((), jnp.int32))
        is_driving = jnp.arange(num_readings) < self.readings
        (robot, reading, _), (driven, readings, passed) = jax.lax.scan(drive, carry, (errors, is_driving))
        driven = jnp.concatenate([driven, robot.qpos[None]])
        readings = jnp.concatenate([readings, reading[None]])
        at = self._reached(passed, path.shape[0])
        return TrackingResult(
            state=SimulatedState(robot, reading.astype(path.dtype)),
            poses=jax.vmap(planar)(driven[at]).astype(path.dtype),
            estimates=readings[at].astype(path.dtype),
            frames=frames_of(driven, FRAME_EVERY),
            failed=simulator.has_diverged(robot),
        )

    @property
    @override
    def turning_radius(self) -> float:
        return self.parameters.turning_radius

    @property
    @override
    def reach(self) -> float:
        """Length of the path that is completed, to within 1 cm, in the time available."""
        # The robot drives at `speed` until the remaining path is `speed / gain`, which then decays
        # exponentially.
        speed, slow = float(self.speed), float(self.speed) / float(self.gain)
        seconds = self.readings * self.simulator.time_step
        return max(
            0.0,
            speed * (seconds - log(max(1.0, slow / STOPPING_DISTANCE)) / float(self.gain))
            + max(slow, STOPPING_DISTANCE),
        )

    def _controls(
        self, route: Route, reading: Float[Array, "3"], passed: Int[Array, ""]
    ) -> tuple[Float[Array, "3"], Int[Array, ""]]:
        """Angles of the front wheels and share of full speed; index of the point of the route just passed."""
        car = self.parameters
        of_car = car.wheelbase, car.half_track, 1.0 / car.turning_radius, car.full_speed
        wheelbase, half_track, sharpest, full_speed, look_ahead, speed, gain = (
            jnp.asarray(number, jnp.float32) for number in (*of_car, self.look_ahead, self.speed, self.gain)
        )
        passed = route.nearest(reading[:2], passed, look_ahead)
        here = route.arc[passed]
        curvature = jnp.clip(pursuit.curvature(reading, route.at(here + look_ahead)), -sharpest, sharpest)
        angles = pursuit.wheel_angles(curvature, wheelbase, half_track)
        speed = jnp.minimum(speed, gain * (route.length - here))
        return jnp.concatenate([angles, (speed / full_speed)[None]]), passed

    def _reached(self, passed: Int[Array, "N"], num_poses: int) -> Int[Array, "S"]:
        """Index of the measurement at which each pose of the path is passed; the last one if it never is."""
        points = PIECES * jnp.arange(1, num_poses + 1, dtype=passed.dtype)
        has_passed = passed[None] >= points[:, None]
        first = jnp.argmax(has_passed, axis=1).astype(passed.dtype)
        last = jnp.asarray(passed.shape[0], passed.dtype)
        return jnp.where(has_passed[:, -1], first, last).at[-1].set(last)
