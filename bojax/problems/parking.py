"""Robot parking (Section 4.7.2): reach a parking spot from a random pose, with the heading along its axis."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.motions.base import Pose, Poses
from bojax.numerics.choices import Choice, one_of
from bojax.problems.pose import Outcome, PoseProblem

RULES = ("printed", "bearing-dropped", "anywhere", "anywhere-bearing-dropped")
"""Rules of parking: (4.13) as printed, and with one or both of its conditions relaxed."""


class Parking(PoseProblem):
    """Drive from a random pose in a square to the pose (0, 0, 0), with the rewards of (4.13).

    The shaped reward has three levels: reach the axis of the parking spot, then align with it, then approach
    the spot. With the heading alpha, the bearing beta and the distance d from the spot at the end of a path,
    the reward of the path is

    - `-|sin beta| - d_max - 1` if `|sin beta| > bearing_tolerance`,
    - otherwise `-|sin alpha| - d_max` if `|sin alpha| > heading_tolerance`,
    - otherwise `-d` if `d > distance_tolerance`,
    - otherwise `success_reward`, and the robot is parked.

    This is the rule `printed`. It needs the bearing even at the spot, where it is nearly arbitrary: with the
    default tolerances and the bearing in the world frame, a robot is parked in a fifth of the disc around the
    spot alone. At d = 0, where beta is undefined, the robot counts as on the axis. The other rules relax
    (4.13) and are paid `success_reward` where the robot is parked: without the bearing, at any pose of a
    path, or both. A robot that may park at any pose stops there, unless it is simulated: then it drives on
    to the end of the path.

    Two points that the thesis leaves open are settings: the frame of the bearing, and whether leaving the
    domain ends the episode. (According to the text it does, but then no return could be far below -1100,
    while the axis of Fig. 4.6 reaches -2400.)

    Settings: `bojax.problems.settings.Parking` and `RobotParking`.
    """

    runs_in_kernels: ClassVar[bool] = True

    half_width: Float[Array, ""]
    distance_tolerance: Float[Array, ""]
    heading_tolerance: Float[Array, ""]
    bearing_tolerance: Float[Array, ""]
    success_reward: Float[Array, ""]
    exit_reward: Float[Array, ""]
    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    rule: Choice = eqx.field(converter=one_of(*RULES))
    exit_terminates: Bool[Array, ""] = eqx.field(converter=jnp.asarray)
    max_steps: int = eqx.field(static=True)
    bearing: Literal["world", "robot"] = eqx.field(static=True)

    @override
    def start(self, key: Key[Array, ""]) -> Pose:
        """A pose drawn uniformly from the domain and all headings."""
        low = jnp.stack([-self.half_width, -self.half_width, jnp.zeros_like(self.half_width)])
        high = jnp.stack([self.half_width, self.half_width, jnp.full_like(self.half_width, 2.0 * jnp.pi)])
        return jax.random.uniform(key, (3,), self.half_width.dtype, low, high)

    @override
    def outcome(self, start: Pose | Poses, path: Float[Array, "S 3"] | Poses) -> Outcome:
        # A path ends at the first pose that parks or leaves the domain.
        index = jnp.arange(path.shape[0], dtype=jnp.int32)
        end = path.shape[0] - 1
        # Elementwise arithmetic: a reduction over the two coordinates would be a kernel of its own on a GPU.
        is_outside = jnp.maximum(jnp.abs(path[..., 0]), jnp.abs(path[..., 1])) > self.half_width
        distance, off_heading, off_axis = self._offsets(path)
        is_parked = (distance <= self.distance_tolerance) & (off_heading <= self.heading_tolerance)
        is_bearing_dropped = self.rule.is_("bearing-dropped") | self.rule.is_("anywhere-bearing-dropped")
        is_anywhere = self.rule.is_("anywhere") | self.rule.is_("anywhere-bearing-dropped")
        is_parked = is_parked & (is_bearing_dropped | (off_axis <= self.bearing_tolerance))
        is_parked = is_parked & (is_anywhere | (index == end))
        first_parked = jnp.min(jnp.where(is_parked, index, end + 1))
        first_outside = jnp.min(jnp.where(is_outside, index, end + 1))
        # With `exit_terminates`, the first pose outside the domain ends the path unless it is parked before.
        farthest_start = jnp.maximum(jnp.abs(start[0]), jnp.abs(start[1]))
        was_inside = self.exit_terminates | (farthest_start <= self.half_width)
        ends_outside = jnp.where(self.exit_terminates, first_outside, end + 1)
        success = (first_parked <= end) & (first_parked < ends_outside)
        exited = was_inside & (first_outside < first_parked)
        terminated = success | (self.exit_terminates & exited)
        last = jnp.minimum(jnp.minimum(first_parked, ends_outside), end)
        farthest = 2.0**0.5 * self.half_width
        distance, off_heading, off_axis = self._offsets(path[-1])
        shaped = jnp.where(
            off_axis > self.bearing_tolerance,
            -off_axis - farthest - 1.0,
            jnp.where(off_heading > self.heading_tolerance, -off_heading - farthest, -distance),
        )
        paid = jnp.where(success, self.success_reward, shaped)
        reward = jnp.where(exited & ~success, self.exit_reward, paid)
        return Outcome(reward, terminated, success, exited, last)

    def _offsets(self, poses: Float[Array, "*S 3"] | Poses) -> tuple[Float[Array, "*S"], ...]:
        """Distance from the spot, |sin alpha|, and |sin beta|, which is 0 at the spot itself."""
        x, y, heading = poses[..., 0], poses[..., 1], poses[..., 2]
        distance = jnp.sqrt(x**2 + y**2)
        across = y
        if self.bearing == "robot":
            across = y * jnp.cos(heading) - x * jnp.sin(heading)
        return distance, jnp.abs(jnp.sin(heading)), jnp.abs(across) / jnp.where(distance > 0.0, distance, 1.0)
