"""Land on a pad (thesis, p. 107): Gym's continuous LunarLander with a goal."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from bojax.envs.control import ControlTask
from bojax.envs.spaces import Box
from bojax.robots import lander_body as body
from bojax.robots.lander import LanderState, drifted, engines, hull_touches, smoothed, thrown

_REST_STEPS = 25  # half a second, after which Box2D puts a body to sleep


class LunarLander(ControlTask):
    """A lander with a main engine below and engines at its sides; physics are those of `bojax.robots.lander`.

    The goal is a distance below `goal_distance` between lander and pad, in the units of the observation
    (p. 107): 0.05 is 0.5 m to the sides and 0.33 m up. Standing on the pad's centre is within. Speed does not
    matter. The failure is to crash, the hull on the ground, or to leave the world to a side. There is no
    ceiling.

    The classic reward is Gym's: the gain in -100 (distance + speed + |angle|) + 10 for each leg on the
    ground, less 0.3 times the main and 0.03 times the side engine's power; -100 at the failure, 100 once it
    has come to rest anywhere, both of which end it.

    It begins as in Gym: at the top, with a push, over a rough terrain that is new in every episode.

    Attributes:
        goal_distance: In units of the observation.
        gravity: In m/s^2.
        main_power: Impulse of the main engine at full power, in N s for each metre between it and the origin.
        side_power: The same of the side engines.
        dispersion: Scale of the noise on direction and strength of an engine's impulse; 1 in Gym, 0 for none.
        max_push: Bound on the force of the first step, in either direction, in N.
        max_speed: Speed, in m/s, or spin, in rad/s, beyond which a simulation counts as diverged.
        max_steps: See `Env`.
        reward: See `ControlTask`.
    """

    goal_distance: Float[Array, ""]
    gravity: Float[Array, ""]
    main_power: Float[Array, ""]
    side_power: Float[Array, ""]
    dispersion: Float[Array, ""]
    max_push: Float[Array, ""]
    max_speed: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    reward: Literal["goal-only", "classic"] = eqx.field(static=True)

    @property
    def observation_space(self) -> Box:
        """Place from the pad and velocity, to the right and up; angle and spin; and whether each leg stands.

        In Gym's units: 10 m, 6.67 m, 5 m/s, 7.5 m/s, 1 rad, 2.5 rad/s. The bounds are those of the author's
        code.
        """
        low = jnp.asarray([-1.2, -0.2, -3.3, -2.8, -3.4, -4.0, 0.0, 0.0], self.gravity.dtype)
        return Box(low, jnp.asarray([1.2, 1.6, 2.0, 0.8, 2.5, 9.0, 1.0, 1.0], self.gravity.dtype))

    @property
    def action_space(self) -> Box:
        """Main and side engine.

        The main one is off below 0, and from there on has half its power to all of it; the side ones are off
        within 0.5 of 0, and a positive number pushes to the right.
        """
        one = jnp.ones((2,), self.gravity.dtype)
        return Box(-one, one)

    def reset(self, key: Key[Array, ""]) -> LanderState:
        """See `Env`."""
        key_heights, key_push = jax.random.split(key)
        dtype = self.gravity.dtype
        heights = jax.random.uniform(key_heights, (body.NUM_HEIGHTS + 1,), dtype, 0.0, 0.5 * body.HEIGHT)
        push = self.max_push * jax.random.uniform(key_push, (2,), dtype, -1.0, 1.0)
        return drifted(thrown(push, smoothed(heights)), self.gravity)

    def observe(self, state: LanderState) -> Float[Array, "8"]:
        """See `observation_space`."""
        x, y = state.origin
        horizontal, vertical = state.hull_velocity
        numbers = [
            (x - body.ORIGIN[0]) / body.UNITS[0],
            (y - body.ORIGIN[1]) / body.UNITS[1],
            horizontal * body.UNITS[0] * body.TIME_STEP,
            vertical * body.UNITS[1] * body.TIME_STEP,
            state.angle,
            state.spin * 20.0 * body.TIME_STEP,
        ]
        return jnp.concatenate([jnp.stack(numbers), state.contacts.astype(x.dtype)])

    def advance(self, key: Key[Array, ""], state: LanderState, action: Float[Array, "2"]) -> LanderState:
        """The engines' impulses, then a step of the physics."""
        noise = self.dispersion * jax.random.uniform(key, (2,), self.gravity.dtype, -1.0, 1.0)
        main, side = _powers(action)
        kicked = engines(state, self.main_power * main, self.side_power * side, noise)
        return drifted(kicked, self.gravity)

    def is_goal(self, state: LanderState) -> Bool[Array, ""]:
        """See the class."""
        x, y = self.observe(state)[:2]
        return jnp.sqrt(x * x + y * y) < self.goal_distance

    def is_failure(self, state: LanderState) -> Bool[Array, ""]:
        """See the class."""
        return hull_touches(state) | (jnp.abs(self.observe(state)[0]) >= 1.0)

    def has_diverged(self, state: LanderState) -> Bool[Array, ""]:
        """See `ControlTask`."""
        fastest = jnp.maximum(jnp.max(jnp.abs(state.velocity)), jnp.abs(state.spin))
        return ~jnp.all(jnp.isfinite(self.observe(state))) | (fastest > self.max_speed)

    def classic(
        self,
        state: LanderState,
        action: Float[Array, "2"],
        success: Bool[Array, ""],
        failure: Bool[Array, ""],
        after: LanderState,
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """See the class."""
        del success
        main, side = _powers(action)
        fuel = 0.3 * main + 0.03 * jnp.abs(side)
        paid = self._shaping(after) - self._shaping(state) - fuel
        is_still = after.num_still >= _REST_STEPS
        paid = jnp.where(failure, jnp.full_like(paid, -100.0), paid)
        return jnp.where(is_still, jnp.full_like(paid, 100.0), paid), failure | is_still

    def frame(self, state: LanderState) -> Float[Array, "13"]:
        """Angles of the legs, and the terrain."""
        return jnp.concatenate([state.legs, state.terrain])

    def _shaping(self, state: LanderState) -> Float[Array, ""]:
        x, y, horizontal, vertical, angle, _, *contacts = self.observe(state)
        away = jnp.sqrt(x * x + y * y) + jnp.sqrt(horizontal**2 + vertical**2) + jnp.abs(angle)
        return 10.0 * sum(contacts) - 100.0 * away


def _powers(action: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Powers of the main engine and of the side ones, from -1 to 1, outside the dead zones."""
    main, side = action
    off = jnp.zeros_like(main)
    return jnp.where(main > 0.0, 0.5 * (1.0 + main), off), jnp.where(jnp.abs(side) > 0.5, side, off)
