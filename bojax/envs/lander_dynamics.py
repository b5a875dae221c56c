"""Planar rigid-body dynamics of a lander on two hinged legs over rough terrain.

The dynamics follow Gym's LunarLander without its physics engine, Box2D: the same masses, the same
semi-implicit Euler step of 1/50 s, and contacts resolved by sequential impulses. There are three
simplifications: a leg has no inertia about its hinge, a leg touches the ground with its lowest corner only,
and the ground below a corner is the plane of the terrain segment below it.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.envs import lander_geometry as geometry
from bojax.envs.lander_geometry import TIME_STEP
from bojax.numerics.lanes import batched_together
from bojax.numerics.pallas import either, kernels_run_here
from bojax.robots.kernel.scalar_kernel import ScalarKernel

_REST, _FOLDED, _HULL = geometry.lander(geometry.LEG_REST), geometry.lander(0.0), geometry.hull()
_MASS, _INERTIA, _CENTRE = _REST.mass, _REST.inertia, float(_REST.centre[1])

_FOOT_FRICTION = math.sqrt(0.2 * 0.1)  # Box2D's geometric mean of the coefficients of leg and ground
_MOTOR_SPEED, _MOTOR_TORQUE = 0.3, 40.0
_FIRST_LEG_ANGLE = 0.542  # joint angle of Gym's legs after the first step

# Box2D surrounds every shape with a skin of 1 cm, allows skins to overlap by 0.5 cm, and reports a contact
# where skins overlap.
_GAP, _TOUCH = 0.015, 0.02

_SWEEPS = 12
_SHORT = 0.05  # lever arm below which the ground does not turn a leg outwards, in metres
_RECOVERY = 0.2  # share of a penetration that is corrected in one step

_SLOW, _SLOW_SPIN = 0.01, math.radians(2.0)


class LanderState(eqx.Module):
    """State of the lander and its terrain."""

    position: Float[Array, "2"]  # centre of mass, in metres from the lower left corner of the world
    angle: Float[Array, ""]  # tilt, anticlockwise, in radians; not wrapped
    velocity: Float[Array, "2"]  # velocity of the centre of mass, in m/s
    spin: Float[Array, ""]  # angular velocity, anticlockwise, in rad/s
    legs: Float[Array, "2"]  # outward joint angles of the right and the left leg, in radians
    contacts: Bool[Array, "2"]  # whether the right and the left leg touch the ground
    num_still: Int[Array, ""]  # number of consecutive steps at rest
    terrain: Float[Array, "11"]  # heights of the terrain vertices, in metres

    @property
    def origin(self) -> Float[Array, "2"]:
        """The hull's origin, to which the legs are hinged, in metres."""
        return self._on_axis(0.0)

    @property
    def hull_velocity(self) -> Float[Array, "2"]:
        """Velocity of the hull's own centre of mass, which Gym's observation reports, in m/s."""
        return self.velocity + self.spin * _left(self._on_axis(float(_HULL.centre[1])) - self.position)

    def _on_axis(self, height: float) -> Float[Array, "2"]:
        """The point on the hull's axis at a height above its origin."""
        return self.position + (height - _CENTRE) * jnp.stack([-jnp.sin(self.angle), jnp.cos(self.angle)])


def reset(push: Float[Array, "2"], terrain: Float[Array, "11"]) -> LanderState:
    """The lander at the top of the world after a force on its hull, in N, has acted for one step.

    The legs are unfolded in the state returned.
    """
    # In Gym, the force acts in the first step, on the lander with folded legs: it acts on the hull's centre
    # of mass, above that of the whole, so that its horizontal component turns the lander.
    lever = float(_HULL.centre[1] - _FOLDED.centre[1])
    height = geometry.HEIGHT + _HULL.mass * float(_HULL.centre[1]) / _MASS  # Gym's legs start at the origin
    return LanderState(
        position=jnp.asarray([0.5 * geometry.WIDTH, height], push.dtype),
        angle=jnp.zeros_like(push[0]),
        velocity=push * TIME_STEP / _MASS,
        spin=-push[0] * TIME_STEP * lever / _FOLDED.inertia,
        legs=jnp.full_like(push, _FIRST_LEG_ANGLE),
        contacts=jnp.zeros(2, bool),
        num_still=jnp.zeros((), jnp.int32),
        terrain=terrain,
    )


def smooth_terrain(heights: Float[Array, "12"]) -> Float[Array, "11"]:
    """Gym's terrain: random heights, levelled around the pad and averaged over three neighbours."""
    levelled = heights.at[geometry.PAD[0] - 1 : geometry.PAD[-1] + 2].set(0.25 * geometry.HEIGHT)
    return 0.33 * (jnp.roll(levelled, 1)[:-1] + levelled[:-1] + levelled[1:])


def apply_engines(
    state: LanderState, main: Float[Array, ""], side: Float[Array, ""], noise: Float[Array, "2"]
) -> LanderState:
    """The state after the impulses of the engines during one step.

    As in Gym, the magnitude of an impulse is proportional to the distance of the engine from the hull's
    origin, noise included.

    Args:
        state: State before the impulses.
        main: Impulse of the main engine for a distance of 1 m, in N s; 0 is off.
        side: Impulse of the side engines for a distance of 1 m; positive values push to the right.
        noise: Random displacement of the engines, in pixels of Gym's window.
    """
    first, second = noise * geometry.PIXEL
    below = _rotated(jnp.stack([-second, -geometry.MAIN_ENGINE - 2.0 * first]), state.angle)
    beside = 3.0 * second + geometry.SIDE_ENGINE[0] * jnp.sign(side)
    beside = _rotated(jnp.stack([-beside, -first]), state.angle)
    # Gym rotates this offset with two different lengths, of 17 and 14 pixels.
    height = jnp.stack(
        [-jnp.sin(state.angle) * geometry.SIDE_ENGINE[1], jnp.cos(state.angle) * geometry.SIDE_ENGINE[2]]
    )
    to_origin = state.origin - state.position
    motion = _Motion(state.velocity, state.spin)
    motion = motion.after_impulse(to_origin + below, -main * below)
    motion = motion.after_impulse(to_origin + beside + height, -jnp.abs(side) * beside)
    return eqx.tree_at(lambda s: (s.velocity, s.spin), state, (motion.velocity, motion.spin))


def separation(
    points: Float[Array, "*N 2"], terrain: Float[Array, "11"]
) -> tuple[Float[Array, "*N"], Float[Array, "*N 2"]]:
    """Signed distances of points from the plane of the terrain segment below them, in metres; its normals."""
    # The plane of the segment below, not the nearest point of the terrain: a lookup in place of a search.
    spacing = geometry.WIDTH / (geometry.NUM_HEIGHTS - 1)
    segment = jnp.clip((points[..., 0] / spacing).astype(jnp.int32), 0, geometry.NUM_HEIGHTS - 2)
    height, slope = terrain[segment], (jnp.diff(terrain) / spacing)[segment]
    above = points[..., 1] - height - slope * (points[..., 0] - spacing * segment.astype(points.dtype))
    cosine = 1.0 / jnp.sqrt(1.0 + slope * slope)
    return above * cosine, jnp.stack([-slope * cosine, cosine], axis=-1)


def hull_touches_ground(state: LanderState) -> Bool[Array, ""]:
    """Whether a corner of the hull touches the ground, or a vertex of the terrain lies inside the hull."""
    dtype = state.position.dtype
    corners = state.origin[None] + _rotated(jnp.asarray(geometry.HULL, dtype), state.angle)
    distance, _ = separation(corners, state.terrain)
    across = jnp.linspace(0.0, geometry.WIDTH, geometry.NUM_HEIGHTS, dtype=dtype)
    peaks = jnp.stack([across, state.terrain], axis=-1)
    edges = jnp.roll(corners, -1, axis=0) - corners
    edges = edges / jnp.linalg.norm(edges, axis=-1, keepdims=True)
    # The corners run anticlockwise: a peak inside the hull is to the left of every edge.
    inwards = _cross(edges[None], peaks[:, None] - corners[None])
    return jnp.any(distance < _TOUCH) | jnp.any(jnp.all(inwards > -_TOUCH, axis=-1))


def step(state: LanderState, gravity: Float[Array, ""]) -> LanderState:
    """The state one time step later, under a downward gravity in m/s^2."""
    # Box2D's order: gravity, then contact impulses by sweeps over the feet, each given the current others
    # (sequential impulses), then positions by the new velocities (semi-implicit Euler).
    feet = _feet(state)
    falling = _Motion(state.velocity.at[1].add(-gravity * TIME_STEP), state.spin)
    motion = _after_contacts(falling, feet)
    right, left = _right_and_left(feet)
    rates = jnp.stack([right.joint_rate(motion), left.joint_rate(motion)])
    is_slow = (jnp.sum(motion.velocity**2) < _SLOW**2) & (jnp.abs(motion.spin) < _SLOW_SPIN)
    return LanderState(
        position=state.position + TIME_STEP * motion.velocity,
        angle=state.angle + TIME_STEP * motion.spin,
        velocity=motion.velocity,
        spin=motion.spin,
        legs=jnp.clip(state.legs + TIME_STEP * rates, geometry.LEG_REST, geometry.LEG_STOP),
        contacts=jnp.stack([foot.is_down(motion) for foot in (right, left)]),
        num_still=jnp.where(is_slow, state.num_still + 1, jnp.zeros_like(state.num_still)),
        terrain=state.terrain,
    )


def _after_contacts(falling: "_Motion", feet: "_Foot") -> "_Motion":
    """The motion after the impulses of the ground."""

    # In a program of XLA, the sweeps are most of the kernels of a step on a GPU.
    def by_kernel(falling: _Motion, feet: _Foot) -> _Motion:
        return ScalarKernel(_after_sweeps, falling, feet, name="lander_sweeps")(falling, feet)

    return either(kernels_run_here(), by_kernel, _after_sweeps, falling, feet)


def _after_sweeps(motion: "_Motion", feet: "_Foot") -> "_Motion":
    """The motion after sweeps over the impulses of both feet, without a kernel."""
    right, left = _right_and_left(feet)

    def sweep(_: Array, carry: tuple[_Motion, Array, Array]) -> tuple[_Motion, Array, Array]:
        motion, first, second = carry
        motion, first = right.solve(motion, first)
        motion, second = left.solve(motion, second)
        return motion, first, second

    nothing = jnp.zeros_like(motion.velocity, shape=(3,))
    start = batched_together((motion, nothing, nothing))
    return jax.lax.fori_loop(0, _SWEEPS, sweep, start)[0]


class _Motion(eqx.Module):
    """Velocity of the centre of mass in m/s, and spin in rad/s."""

    velocity: Float[Array, "2"]
    spin: Float[Array, ""]

    def along(self, direction: Float[Array, "2"], arm: Float[Array, "2"]) -> Float[Array, ""]:
        """Velocity component along a direction of the point at `arm` from the centre of mass."""
        # A sum rather than a matrix product, which accelerators compute at reduced precision in 32 bits.
        return jnp.sum(direction * (self.velocity + self.spin * _left(arm)))

    def after_impulse(self, arm: Float[Array, "2"], impulse: Float[Array, "2"]) -> "_Motion":
        """The motion after an impulse at the point at `arm` from the centre of mass."""
        return _Motion(self.velocity + impulse / _MASS, self.spin + _cross(arm, impulse) / _INERTIA)


class _Foot(eqx.Module):
    """The lowest corner of a leg during one step, with the contact impulses of Box2D's sequential solver.

    A leg rotates outwards at a rate between two limits. Its motor holds the lower rate as long as the torque
    of the ground's impulse about the hinge stays below the motor's; beyond that the leg yields, up to the
    rate that takes the joint to its stop within the step. The ground therefore exerts three impulses: a soft
    one, bounded by the motor, which stops a foot in contact; a hard one, for a leg at its stop; and friction.
    """

    arm: Float[Array, "*N 2"]  # vector from the centre of mass to the foot, in metres
    normal: Float[Array, "*N 2"]  # normal of the ground below
    soft_speed: Float[Array, "*N"]  # normal velocity that the soft impulse restores to the foot, in m/s
    # Normal velocity that the hard impulse restores to the foot, in m/s; negative above the ground, so that
    # the foot may come down to it
    hard_speed: Float[Array, "*N"]
    distance: Float[Array, "*N"]  # distance from the ground, in metres
    lever: Float[Array, "*N"]  # outward torque about the hinge of a unit force along the normal, in metres
    # Outward torque about the hinge of a unit force along the ground, in metres
    drag_lever: Float[Array, "*N"]
    slowest: Float[Array, "*N"]  # lower limit of the outward joint rate, in rad/s
    fastest: Float[Array, "*N"]  # upper limit of the outward joint rate, in rad/s

    def solve(self, motion: _Motion, impulses: Float[Array, "3"]) -> tuple[_Motion, Float[Array, "3"]]:
        """One sweep over the soft, the hard and the friction impulse, each given the current other two."""
        # Impulses accumulate over the sweeps and the totals are clipped, not the changes, as in Box2D: a
        # sweep may take back what an earlier one gave too much. Motion takes the difference each time.
        soft, hard, drag = impulses
        mass = _effective_mass(self.arm, self.normal)
        # The motor bounds the soft impulse by the torque that friction leaves of it. A leg with too short a
        # lever does not give: it is rigid, the soft impulse has no bound, and there is no hard one.
        gives = self.lever > _SHORT
        spare = jnp.maximum(TIME_STEP * _MOTOR_TORQUE - self.drag_lever * drag, 0.0)
        most = jnp.where(gives, spare / jnp.where(gives, self.lever, 1.0), jnp.inf)

        # Soft: the foot's velocity with the leg turning at the motor's rate must not be into the ground.
        missing = self.soft_speed - self.slowest * self.lever - motion.along(self.normal, self.arm)
        after = jnp.clip(soft + mass * missing, 0.0, most)
        motion, soft = motion.after_impulse(self.arm, (after - soft) * self.normal), after

        # Hard: the same with the leg turning as fast as its stop permits, without a bound.
        missing = self.hard_speed - self.fastest * self.lever - motion.along(self.normal, self.arm)
        after = jnp.where(gives, jnp.maximum(hard + mass * missing, 0.0), 0.0)
        motion, hard = motion.after_impulse(self.arm, (after - hard) * self.normal), after

        # Friction holds the foot within Coulomb's cone of the impulses along the normal.
        along = _left(self.normal)
        speed = motion.along(along, self.arm) + self.joint_rate(motion) * self.drag_lever
        bound = _FOOT_FRICTION * (soft + hard)
        after = jnp.clip(drag - speed * _effective_mass(self.arm, along), -bound, bound)
        return motion.after_impulse(self.arm, (after - drag) * along), jnp.stack([soft, hard, after])

    def joint_rate(self, motion: _Motion) -> Float[Array, ""]:
        """Outward joint rate that keeps the foot out of the ground, within its limits, in rad/s."""
        gives = self.lever > _SHORT
        needed = -self.distance / TIME_STEP - motion.along(self.normal, self.arm)
        needed = jnp.where(gives, needed / jnp.where(gives, self.lever, 1.0), self.slowest)
        return jnp.clip(needed, self.slowest, self.fastest)

    def is_down(self, motion: _Motion) -> Bool[Array, ""]:
        """Whether the foot touches the ground after the step."""
        leaves = motion.along(self.normal, self.arm) + self.joint_rate(motion) * self.lever
        return self.distance + TIME_STEP * leaves < _TOUCH - _GAP


def _feet(state: LanderState) -> _Foot:
    """The right and the left foot, as one batch."""
    dtype = state.position.dtype
    # The left leg is the mirror image of the right one: both are one batch, and of the four corners of each
    # the lowest over the ground is the foot.
    mirror = jnp.asarray([[1.0, 1.0], [-1.0, 1.0]], dtype)
    outwards = mirror[:, 0]
    at_rest = jnp.asarray(geometry.LEG_CENTRE + geometry.LEG, dtype)
    turned = _rotated(at_rest[None], state.legs[:, None] + geometry.LEG_FOLDED) * mirror[:, None]
    corners = _rotated(turned, state.angle)
    distances, normals = separation(state.origin[None, None] + corners, state.terrain)
    lowest = jnp.argmin(distances, axis=1)
    corner, normal = (jnp.take_along_axis(x, lowest[:, None, None], axis=1)[:, 0] for x in (corners, normals))
    distance = jnp.take_along_axis(distances, lowest[:, None], axis=1)[:, 0] - _GAP
    lever = outwards * _cross(corner, normal)
    gives = lever > _SHORT
    # Above the ground, a foot may fall by its distance within the step; in the ground, a share of the depth
    # is corrected (Box2D's Baumgarte factor).
    hard_speed = -jnp.where(distance > 0.0, distance, _RECOVERY * distance) / TIME_STEP
    return _Foot(
        arm=corner + (state.origin - state.position)[None],
        normal=normal,
        soft_speed=jnp.where(gives, jnp.where(distance < _TOUCH - _GAP, 0.0, -jnp.inf), hard_speed),
        hard_speed=hard_speed,
        distance=distance,
        lever=lever,
        drag_lever=outwards * _cross(corner, _left(normal)),
        slowest=jnp.maximum((geometry.LEG_REST - state.legs) / TIME_STEP, -_MOTOR_SPEED),
        fastest=(geometry.LEG_STOP - state.legs) / TIME_STEP,
    )


def _right_and_left(feet: _Foot) -> tuple[_Foot, _Foot]:
    """The right and the left foot of a batch of both."""
    right, left = (jax.tree.map(lambda x, side=side: x[side], feet) for side in range(2))
    return right, left


def _effective_mass(arm: Float[Array, "2"], direction: Float[Array, "2"]) -> Float[Array, ""]:
    """Impulse along a direction that changes the velocity of a point along it by 1 m/s, in kg."""
    return 1.0 / (1.0 / _MASS + _cross(arm, direction) ** 2 / _INERTIA)


def _rotated(vectors: Float[Array, "... 2"], angle: Float[Array, "..."]) -> Float[Array, "... 2"]:
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _left(vector: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
    """The vector rotated anticlockwise by a right angle."""
    return jnp.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def _cross(a: Float[Array, "... 2"], b: Float[Array, "... 2"]) -> Float[Array, "..."]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
