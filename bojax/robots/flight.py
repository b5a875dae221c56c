"""Flight of a quadrotor: a smooth reference trajectory through planned poses, and the tracking controller.

The controller is that of Lee, Leok and McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)"
(CDC 2010), equations 15 to 19, with gains per unit of mass and inertia. Angular acceleration is fed forward
about the vertical axis only, since a trajectory at constant altitude prescribes no other.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.numerics.angles import wrap_to_pi
from bojax.numerics.linalg import matmul

POSITION_GAIN, VELOCITY_GAIN = 9.0, 5.4
"""Gains of the position loop in 1/s^2 and 1/s: natural frequency 3 rad/s, damping ratio 0.9."""

ATTITUDE_GAIN, RATE_GAIN = (144.0, 144.0, 16.0), (20.0, 20.0, 7.0)
"""Gains of the attitude loop about x, y and z in 1/s^2 and 1/s: 12 rad/s, and 4 rad/s about z."""

_LEAST_LENGTH = 1e-6
"""Shorter segments count as standing still, in metres."""


class Airframe(eqx.Module):
    """Parameters of the robot that the controller uses."""

    mass: Float[Array, ""]  # mass in kg
    inertia: Float[Array, "3"]  # principal moments of inertia, in kg m^2
    gravity: Float[Array, ""]  # gravity in m/s^2
    # Rotor thrusts in N for 1 N of total thrust and 1 N m of torque about x, y and z
    mixer: Float[Array, "4 4"]
    max_thrust: Float[Array, ""]  # largest thrust of a rotor, in N

    def thrusts(self, thrust: Float[Array, ""], torque: Float[Array, "3"]) -> Float[Array, "4"]:
        """Rotor thrusts that produce a total thrust and a torque, clipped to the range of the rotors."""
        wanted = jnp.concatenate([thrust[None], torque])
        return jnp.clip(matmul(self.mixer, wanted), 0.0, self.max_thrust)


class Reference(eqx.Module):
    """Reference of the controller at one time or at several."""

    position: Float[Array, "*N 3"]  # position in metres
    velocity: Float[Array, "*N 3"]  # velocity in m/s
    acceleration: Float[Array, "*N 3"]  # acceleration in m/s^2
    yaw: Float[Array, "*N"]  # heading in rad
    yaw_rate: Float[Array, "*N"]  # rate of the heading in rad/s
    yaw_acceleration: Float[Array, "*N"]  # angular acceleration of the heading in rad/s^2


def control(
    airframe: Airframe,
    reference: Reference,
    position: Float[Array, "3"],
    velocity: Float[Array, "3"],
    rotation: Float[Array, "3 3"],
    rates: Float[Array, "3"],
) -> Float[Array, "4"]:
    """Rotor thrusts in N that track a reference, given what was measured.

    Position and velocity are in the world frame, in m and m/s. The rotation is from the body frame (x
    forward, z up) to the world frame, and the rates are the angular velocity in the body frame, in rad/s.
    """
    up = jnp.asarray([0.0, 0.0, 1.0], position.dtype)
    acceleration = (
        reference.acceleration
        + POSITION_GAIN * (reference.position - position)
        + VELOCITY_GAIN * (reference.velocity - velocity)
        + airframe.gravity * up
    )
    wanted = _attitude(acceleration, reference.yaw)
    # The attitude error of the paper, 1/2 (Rd'R - R'Rd) as a vector: zero where the attitudes agree.
    turn = matmul(wanted.T, rotation)
    error = 0.5 * _vee(turn - turn.T)
    vertical = rotation[2]  # in the body frame
    stiffness, damping = jnp.asarray(ATTITUDE_GAIN, error.dtype), jnp.asarray(RATE_GAIN, error.dtype)
    angular = (
        reference.yaw_acceleration * vertical
        - stiffness * error
        + damping * (reference.yaw_rate * vertical - rates)
    )
    torque = airframe.inertia * angular + jnp.cross(rates, airframe.inertia * rates)
    return airframe.thrusts(airframe.mass * jnp.sum(acceleration * rotation[:, 2]), torque)


def reference_trajectory(
    start: Float[Array, "3"],
    path: Float[Array, "S 3"],
    end_heading: Float[Array, ""],
    altitude: Float[Array, ""],
    time_step: float,
    path_steps: int,
    rest_steps: int,
) -> tuple[Reference, Int[Array, "S"]]:
    """Trajectory from rest at a pose through further poses to rest, followed by a turn on the spot.

    Positions follow cubic Hermite curves between the poses, tangential to their headings. Arc length and the
    angle of the final turn have minimum-jerk profiles from rest to rest. The heading is linear in arc length
    between poses. Repeated poses, the end of a path on which the robot was stopped, are no motion.

    Args:
        start: Initial pose.
        path: Poses at approximately equal distances.
        end_heading: Heading after the turn, in rad.
        altitude: Constant altitude, in metres.
        time_step: Duration of a control step, in seconds.
        path_steps: Control steps of the flight.
        rest_steps: Control steps of the turn.

    Returns:
        The reference at every control step, and the control step at which it reaches each pose of the path.
    """
    dtype = path.dtype
    knots = jnp.concatenate([start[None], path])
    turns = wrap_to_pi(knots[1:, 2] - knots[:-1, 2])
    yaws = jnp.concatenate([start[2:], start[2] + jnp.cumsum(turns)])
    pieces = jnp.sqrt(jnp.sum((knots[1:, :2] - knots[:-1, :2]) ** 2, axis=-1))
    ends = jnp.cumsum(pieces)
    length = ends[-1]

    share, share_rate, share_acceleration = _minimum_jerk(path_steps, rest_steps, time_step, dtype)
    arc, speed, gain = length * share, length * share_rate, length * share_acceleration
    # At each control step, the segment between poses that the arc length has come to, and the part of it
    # that is behind. A segment without length has a chord of 1 and a part of 0, against a division by 0.
    is_past = arc[:, None] >= ends[None, :]
    piece = jnp.minimum(jnp.sum(is_past, axis=1, dtype=jnp.int32), path.shape[0] - 1)
    is_short = pieces[piece] < _LEAST_LENGTH
    chord = jnp.where(is_short, 1.0, pieces[piece])
    part = jnp.where(is_short, 0.0, (arc - (ends - pieces)[piece]) / chord)

    directions = jnp.stack([jnp.cos(knots[:, 2]), jnp.sin(knots[:, 2])], axis=-1)
    place, slope, bend = _hermite(
        part, knots[piece, :2], knots[piece + 1, :2], directions[piece], directions[piece + 1], chord
    )
    is_still = is_short[:, None]
    slope, bend = jnp.where(is_still, 0.0, slope), jnp.where(is_still, 0.0, bend)
    yaw_slope = jnp.where(is_short, 0.0, turns[piece] / chord)

    # The final turn has the same profile in time, beginning when the flight ends.
    turn = wrap_to_pi(end_heading - yaws[-1])
    swing, swing_rate, swing_acceleration = _minimum_jerk(rest_steps, 0, time_step, dtype, path_steps)
    flat = jnp.zeros_like(arc)[:, None]
    # Chain rule through the arc length s(t): x' = x_s s', x'' = x_ss s'^2 + x_s s''. The heading is linear in
    # s between poses, so that its acceleration there, x_s s'', is left to the feedback.
    reference = Reference(
        position=jnp.concatenate([place, flat + altitude], axis=1),
        velocity=jnp.concatenate([slope * speed[:, None], flat], axis=1),
        acceleration=jnp.concatenate([bend * (speed * speed)[:, None] + slope * gain[:, None], flat], axis=1),
        yaw=yaws[piece] + turns[piece] * part + turn * swing,
        yaw_rate=yaw_slope * speed + turn * swing_rate,
        yaw_acceleration=turn * swing_acceleration,
    )
    # A tolerance: near the end arc length hardly grows, and rounding must not delay the arrival there.
    is_there = arc[None, :] >= (ends * (1.0 - 1e-6))[:, None]
    first = jnp.argmax(is_there, axis=1).astype(jnp.int32)
    return reference, jnp.where(length < _LEAST_LENGTH, jnp.full_like(first, path_steps), first)


def _attitude(acceleration: Float[Array, "3"], yaw: Float[Array, ""]) -> Float[Array, "3 3"]:
    """The attitude with a heading in which thrust produces an acceleration that includes gravity."""
    z = acceleration / jnp.linalg.norm(acceleration)
    heading = jnp.stack([jnp.cos(yaw), jnp.sin(yaw), jnp.zeros_like(yaw)])
    y = jnp.cross(z, heading)
    y = y / jnp.linalg.norm(y)
    return jnp.stack([jnp.cross(y, z), y, z], axis=1)


def _vee(matrix: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The vector v with `matrix w = v x w`."""
    return jnp.stack([matrix[2, 1], matrix[0, 2], matrix[1, 0]])


def _minimum_jerk(
    num_steps: int, after: int, time_step: float, dtype: jnp.dtype, before: int = 0
) -> tuple[Float[Array, "N"], Float[Array, "N"], Float[Array, "N"]]:
    """Minimum-jerk profile from 0 to 1 in `num_steps` steps: values, their rates and accelerations."""
    step = jnp.arange(before + num_steps + after, dtype=dtype) - before
    t = jnp.clip(step / num_steps, 0.0, 1.0)
    seconds = num_steps * time_step
    return (
        t**3 * (10 - 15 * t + 6 * t * t),
        30 * t * t * (1 - t) ** 2 / seconds,
        60 * t * (1 - t) * (1 - 2 * t) / seconds**2,
    )


def _hermite(
    u: Float[Array, "N"],
    begin: Float[Array, "N 2"],
    end: Float[Array, "N 2"],
    leaving: Float[Array, "N 2"],
    arriving: Float[Array, "N 2"],
    chord: Float[Array, "N"],
) -> tuple[Float[Array, "N 2"], Float[Array, "N 2"], Float[Array, "N 2"]]:
    """Points on Hermite curves with unit tangents; first and second derivatives by arc length."""
    u, chord = u[:, None], chord[:, None]
    jump = end - begin
    place = (
        begin + (3 - 2 * u) * u * u * jump + chord * ((1 - u) ** 2 * u * leaving - (1 - u) * u * u * arriving)
    )
    slope = 6 * u * (1 - u) * jump / chord + (1 - u) * (1 - 3 * u) * leaving + u * (3 * u - 2) * arriving
    bend = (6 - 12 * u) * jump / chord + (6 * u - 4) * leaving + (6 * u - 2) * arriving
    return place, slope, bend / chord
