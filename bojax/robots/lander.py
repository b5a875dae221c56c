"""A lander over a rough moon: one rigid body in a plane, on two legs that give way to a hard landing.

Gym's LunarLander without the physics engine that steps it there (Box2D): the same masses and the same
semi-implicit Euler step of 1/50 s, with contacts solved for impulses, as there. Three things are simpler:
legs weigh nothing where they turn, a leg touches with its lowest corner, and the ground below a corner is
the plane of the segment below it.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bojax.robots import lander_body as body
from bojax.robots.lander_body import TIME_STEP

_REST, _FOLDED, _HULL = body.lander(body.LEG_REST), body.lander(0.0), body.hull()
_MASS, _INERTIA, _CENTRE = _REST.mass, _REST.inertia, float(_REST.centre[1])

_FOOT_FRICTION = math.sqrt(0.2 * 0.1)  # Box2D's mean of leg and ground
_MOTOR_SPEED, _MOTOR_TORQUE = 0.3, 40.0
_FIRST_LEG_ANGLE = 0.542  # where Gym's legs are after their first step

# Box2D gives every shape a skin of 1 cm, lets skins overlap by 0.5 cm, and calls overlapping skins a contact.
_GAP, _TOUCH = 0.015, 0.02

_SWEEPS = 12
_SHORT = 0.05  # lever below which the ground does not turn a leg outwards, in metres
_RECOVERY = 0.2  # share of a penetration that a step takes back

_SLOW, _SLOW_SPIN = 0.01, math.radians(2.0)


class LanderState(eqx.Module):
    """Where the lander is, over which terrain.

    Attributes:
        position: Its centre of mass, in metres from the lower left corner of the world.
        angle: Its tilt, anticlockwise, in radians; not wrapped.
        velocity: Of the centre of mass, in m/s.
        spin: Anticlockwise, in rad/s.
        legs: Angles of the joints of the right and of the left leg, outwards, in radians.
        contacts: Which of them stand on the ground.
        num_still: Steps in a row at rest.
        terrain: Heights at equal distances across the world, in metres.
    """

    position: Float[Array, "2"]
    angle: Float[Array, ""]
    velocity: Float[Array, "2"]
    spin: Float[Array, ""]
    legs: Float[Array, "2"]
    contacts: Bool[Array, "2"]
    num_still: Int[Array, ""]
    terrain: Float[Array, "11"]

    @property
    def origin(self) -> Float[Array, "2"]:
        """The hull's origin, in which the legs hinge, in metres."""
        return self._on_axis(0.0)

    @property
    def hull_velocity(self) -> Float[Array, "2"]:
        """Velocity of the hull's own centre of mass, which is the one that Gym tells, in m/s."""
        return self.velocity + self.spin * _left(self._on_axis(float(_HULL.centre[1])) - self.position)

    def _on_axis(self, height: float) -> Float[Array, "2"]:
        """The point of the hull's axis at this height above its origin."""
        return self.position + (height - _CENTRE) * jnp.stack([-jnp.sin(self.angle), jnp.cos(self.angle)])


def thrown(push: Float[Array, "2"], terrain: Float[Array, "11"]) -> LanderState:
    """A lander at the top of the world, after a push on its hull of so many N over one step.

    Its legs are still folded, so that a push to the side turns it, too; they unfold at once.
    """
    lever = float(_HULL.centre[1] - _FOLDED.centre[1])
    height = body.HEIGHT + _HULL.mass * float(_HULL.centre[1]) / _MASS  # with the legs beside the origin
    return LanderState(
        position=jnp.asarray([0.5 * body.WIDTH, height], push.dtype),
        angle=jnp.zeros_like(push[0]),
        velocity=push * TIME_STEP / _MASS,
        spin=-push[0] * TIME_STEP * lever / _FOLDED.inertia,
        legs=jnp.full_like(push, _FIRST_LEG_ANGLE),
        contacts=jnp.zeros(2, bool),
        num_still=jnp.zeros((), jnp.int32),
        terrain=terrain,
    )


def smoothed(heights: Float[Array, "12"]) -> Float[Array, "11"]:
    """Gym's terrain: heights with those around the pad levelled, averaged over three neighbours."""
    levelled = heights.at[body.PAD[0] - 1 : body.PAD[-1] + 2].set(0.25 * body.HEIGHT)
    return 0.33 * (jnp.roll(levelled, 1)[:-1] + levelled[:-1] + levelled[1:])


def engines(
    state: LanderState, main: Float[Array, ""], side: Float[Array, ""], noise: Float[Array, "2"]
) -> LanderState:
    """The lander after one step's impulses of its engines.

    As in Gym, the impulse of an engine is as long as the engine is away from the origin, noise included.

    Args:
        state: The lander.
        main: Power of the main engine, times the impulse of 1 m, in N s; 0 is off.
        side: The same of the side engines; positive pushes to the right.
        noise: Displaces the engines, in pixels of Gym's window.
    """
    first, second = noise * body.PIXEL
    below = _rotated(jnp.stack([-second, -body.MAIN_ENGINE - 2.0 * first]), state.angle)
    beside = 3.0 * second + body.SIDE_ENGINE[0] * jnp.sign(side)
    beside = _rotated(jnp.stack([-beside, -first]), state.angle)
    # Gym turns this height with two different lengths, of 17 and 14 pixels.
    height = jnp.stack(
        [-jnp.sin(state.angle) * body.SIDE_ENGINE[1], jnp.cos(state.angle) * body.SIDE_ENGINE[2]]
    )
    to_origin = state.origin - state.position
    motion = _Motion(state.velocity, state.spin)
    motion = motion.kicked(to_origin + below, -main * below)
    motion = motion.kicked(to_origin + beside + height, -jnp.abs(side) * beside)
    return eqx.tree_at(lambda s: (s.velocity, s.spin), state, (motion.velocity, motion.spin))


def separation(
    points: Float[Array, "*N 2"], terrain: Float[Array, "11"]
) -> tuple[Float[Array, "*N"], Float[Array, "*N 2"]]:
    """Distances of points to the plane of the ground below them, in metres, and the normals of it."""
    spacing = body.WIDTH / (body.NUM_HEIGHTS - 1)
    segment = jnp.clip((points[..., 0] / spacing).astype(jnp.int32), 0, body.NUM_HEIGHTS - 2)
    height, slope = terrain[segment], (jnp.diff(terrain) / spacing)[segment]
    above = points[..., 1] - height - slope * (points[..., 0] - spacing * segment.astype(points.dtype))
    cosine = 1.0 / jnp.sqrt(1.0 + slope * slope)
    return above * cosine, jnp.stack([-slope * cosine, cosine], axis=-1)


def hull_touches(state: LanderState) -> Bool[Array, ""]:
    """Whether the hull is on the ground: a corner of it, or a peak of the terrain within it."""
    dtype = state.position.dtype
    corners = state.origin[None] + _rotated(jnp.asarray(body.HULL, dtype), state.angle)
    distance, _ = separation(corners, state.terrain)
    across = jnp.linspace(0.0, body.WIDTH, body.NUM_HEIGHTS, dtype=dtype)
    peaks = jnp.stack([across, state.terrain], axis=-1)
    edges = jnp.roll(corners, -1, axis=0) - corners
    edges = edges / jnp.linalg.norm(edges, axis=-1, keepdims=True)
    inwards = _cross(edges[None], peaks[:, None] - corners[None])
    return jnp.any(distance < _TOUCH) | jnp.any(jnp.all(inwards > -_TOUCH, axis=-1))


def drifted(state: LanderState, gravity: Float[Array, ""]) -> LanderState:
    """The lander one time step later, under gravity in m/s^2 downwards."""
    feet = _feet(state)
    right, left = (jax.tree.map(lambda x, side=side: x[side], feet) for side in range(2))

    def sweep(_: Array, carry: tuple[_Motion, Array, Array]) -> tuple[_Motion, Array, Array]:
        motion, first, second = carry
        motion, first = right.solved(motion, first)
        motion, second = left.solved(motion, second)
        return motion, first, second

    nothing = jnp.zeros_like(state.position, shape=(3,))
    falling = _Motion(state.velocity.at[1].add(-gravity * TIME_STEP), state.spin)
    motion, _, _ = jax.lax.fori_loop(0, _SWEEPS, sweep, (falling, nothing, nothing))
    turns = jnp.stack([right.turn(motion), left.turn(motion)])
    is_slow = (jnp.sum(motion.velocity**2) < _SLOW**2) & (jnp.abs(motion.spin) < _SLOW_SPIN)
    return LanderState(
        position=state.position + TIME_STEP * motion.velocity,
        angle=state.angle + TIME_STEP * motion.spin,
        velocity=motion.velocity,
        spin=motion.spin,
        legs=jnp.clip(state.legs + TIME_STEP * turns, body.LEG_REST, body.LEG_STOP),
        contacts=jnp.stack([foot.is_down(motion) for foot in (right, left)]),
        num_still=jnp.where(is_slow, state.num_still + 1, jnp.zeros_like(state.num_still)),
        terrain=state.terrain,
    )


class _Motion(eqx.Module):
    """Velocity of the centre of mass, and spin."""

    velocity: Float[Array, "2"]
    spin: Float[Array, ""]

    def along(self, direction: Float[Array, "2"], arm: Float[Array, "2"]) -> Float[Array, ""]:
        """Velocity of a point of the rigid body in a direction."""
        # No product of matrices: accelerators round those of 32-bit numbers.
        return jnp.sum(direction * (self.velocity + self.spin * _left(arm)))

    def kicked(self, arm: Float[Array, "2"], impulse: Float[Array, "2"]) -> "_Motion":
        """The motion after an impulse at a point."""
        return _Motion(self.velocity + impulse / _MASS, self.spin + _cross(arm, impulse) / _INERTIA)


class _Foot(eqx.Module):
    """Lowest corner of a leg during one step, for impulses as of Box2D's sequential solver.

    A leg turns outwards at a rate within limits. Its motor brings it to the least one, as long as the impulse
    of the ground has less torque about the hinge than the motor's; then it gives way, up to the rate that
    takes it to its stop within the step. So the ground pushes with three impulses: a soft one, bounded by the
    motor, which stops a foot that touches; a hard one, for a leg at its stop; and friction.

    Attributes:
        arm: From the centre of mass to the foot, in metres.
        normal: Of the ground below.
        soft_speed: Velocity away from the ground that the soft impulse gives the foot, in m/s.
        hard_speed: The same of the hard one, which is negative above the ground: to come down to it.
        distance: From the ground, in metres.
        lever: Torque about the hinge, outwards, of a unit along the normal, in metres.
        drag_lever: The same of a unit along the ground.
        slowest: Least rate of turning outwards, in rad/s.
        fastest: Largest rate.
    """

    arm: Float[Array, "*N 2"]
    normal: Float[Array, "*N 2"]
    soft_speed: Float[Array, "*N"]
    hard_speed: Float[Array, "*N"]
    distance: Float[Array, "*N"]
    lever: Float[Array, "*N"]
    drag_lever: Float[Array, "*N"]
    slowest: Float[Array, "*N"]
    fastest: Float[Array, "*N"]

    def solved(self, motion: _Motion, impulses: Float[Array, "3"]) -> tuple[_Motion, Float[Array, "3"]]:
        """One sweep: the soft, the hard and the friction impulse, each as the others are."""
        soft, hard, drag = impulses
        mass = _effective_mass(self.arm, self.normal)
        gives = self.lever > _SHORT
        spare = jnp.maximum(TIME_STEP * _MOTOR_TORQUE - self.drag_lever * drag, 0.0)
        most = jnp.where(gives, spare / jnp.where(gives, self.lever, 1.0), jnp.inf)

        wanted = self.soft_speed - self.slowest * self.lever - motion.along(self.normal, self.arm)
        after = jnp.clip(soft + mass * wanted, 0.0, most)
        motion, soft = motion.kicked(self.arm, (after - soft) * self.normal), after

        wanted = self.hard_speed - self.fastest * self.lever - motion.along(self.normal, self.arm)
        after = jnp.where(gives, jnp.maximum(hard + mass * wanted, 0.0), 0.0)
        motion, hard = motion.kicked(self.arm, (after - hard) * self.normal), after

        along = _left(self.normal)
        speed = motion.along(along, self.arm) + self.turn(motion) * self.drag_lever
        bound = _FOOT_FRICTION * (soft + hard)
        after = jnp.clip(drag - speed * _effective_mass(self.arm, along), -bound, bound)
        return motion.kicked(self.arm, (after - drag) * along), jnp.stack([soft, hard, after])

    def turn(self, motion: _Motion) -> Float[Array, ""]:
        """Rate at which the leg turns outwards: what keeps its foot out of the ground, within its limits."""
        gives = self.lever > _SHORT
        needed = -self.distance / TIME_STEP - motion.along(self.normal, self.arm)
        needed = jnp.where(gives, needed / jnp.where(gives, self.lever, 1.0), self.slowest)
        return jnp.clip(needed, self.slowest, self.fastest)

    def is_down(self, motion: _Motion) -> Bool[Array, ""]:
        """Whether the foot touches the ground after the step."""
        leaves = motion.along(self.normal, self.arm) + self.turn(motion) * self.lever
        return self.distance + TIME_STEP * leaves < _TOUCH - _GAP


def _feet(state: LanderState) -> _Foot:
    """Both feet: the right one, and the left one."""
    dtype = state.position.dtype
    mirror = jnp.asarray([[1.0, 1.0], [-1.0, 1.0]], dtype)
    outwards = mirror[:, 0]
    at_rest = jnp.asarray(body.LEG_CENTRE + body.LEG, dtype)
    turned = _rotated(at_rest[None], state.legs[:, None] + body.LEG_FOLDED) * mirror[:, None]
    corners = _rotated(turned, state.angle)
    distances, normals = separation(state.origin[None, None] + corners, state.terrain)
    lowest = jnp.argmin(distances, axis=1)
    corner, normal = (jnp.take_along_axis(x, lowest[:, None, None], axis=1)[:, 0] for x in (corners, normals))
    distance = jnp.take_along_axis(distances, lowest[:, None], axis=1)[:, 0] - _GAP
    lever = outwards * _cross(corner, normal)
    gives = lever > _SHORT
    hard_speed = -jnp.where(distance > 0.0, distance, _RECOVERY * distance) / TIME_STEP
    return _Foot(
        arm=corner + (state.origin - state.position)[None],
        normal=normal,
        soft_speed=jnp.where(gives, jnp.where(distance < _TOUCH - _GAP, 0.0, -jnp.inf), hard_speed),
        hard_speed=hard_speed,
        distance=distance,
        lever=lever,
        drag_lever=outwards * _cross(corner, _left(normal)),
        slowest=jnp.maximum((body.LEG_REST - state.legs) / TIME_STEP, -_MOTOR_SPEED),
        fastest=(body.LEG_STOP - state.legs) / TIME_STEP,
    )


def _effective_mass(arm: Float[Array, "2"], direction: Float[Array, "2"]) -> Float[Array, ""]:
    """Impulse in a direction that changes the velocity of a point in it by 1 m/s, in kg."""
    return 1.0 / (1.0 / _MASS + _cross(arm, direction) ** 2 / _INERTIA)


def _rotated(vectors: Float[Array, "... 2"], angle: Float[Array, "..."]) -> Float[Array, "... 2"]:
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _left(vector: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
    """The vector turned by a right angle, anticlockwise."""
    return jnp.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def _cross(a: Float[Array, "... 2"], b: Float[Array, "... 2"]) -> Float[Array, "..."]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
