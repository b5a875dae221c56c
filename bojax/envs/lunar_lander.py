"""Land on a pad (thesis, p. 107): Gym's continuous LunarLander with a goal."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs import lander_dynamics as dynamics
from bojax.envs import lander_geometry as geometry
from bojax.envs.control import ControlStep, ControlTask, penalties
from bojax.envs.lander_dynamics import LanderState
from bojax.envs.spaces import Box
from bojax.numerics.choices import Choice, one_of

_REST_STEPS = 25  # Box2D puts a body to sleep after half a second at rest


class LunarLander(ControlTask):
    """Land on a pad with a main engine below the hull and engines at its sides.

    The dynamics are in `bojax.envs.lander_dynamics`. Standing on the centre of the pad reaches the goal,
    which has no condition on speed. An episode fails if the hull touches the ground or the lander leaves the
    world sideways. There is no ceiling.

    The classic reward is Gym's: the increase of -100 (distance + speed + |angle|) + 10 for each leg on the
    ground, minus 0.3 times the power of the main engine and 0.03 times the side engines' power. A failure
    pays -100 and coming to rest anywhere pays 100; both end the episode. With `classic_reward: published` it
    is the author's, see `bojax.envs.control.penalties`.

    As in Gym, an episode starts at the top of the world with a random force on the hull, over a rough terrain
    drawn for each episode.

    Settings: `bojax.envs.settings.LunarLander`.
    """

    goal_distance: Float[Array, ""]
    gravity: Float[Array, ""]
    main_power: Float[Array, ""]
    side_power: Float[Array, ""]
    dispersion: Float[Array, ""]
    max_push: Float[Array, ""]
    max_speed: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    goal: Choice = eqx.field(converter=one_of("distance", "box"))
    classic_reward: Choice = eqx.field(converter=one_of("gym", "published"))

    @property
    @override
    def observation_space(self) -> Box:
        """Position relative to the pad, velocity, angle, spin, and ground contact of the right and left leg.

        Units are Gym's: 10 m, 6.67 m, 5 m/s, 7.5 m/s, 1 rad, 2.5 rad/s. The bounds come from the author's
        code.
        """
        low = jnp.asarray([-1.2, -0.2, -3.3, -2.8, -3.4, -4.0, 0.0, 0.0], self.gravity.dtype)
        return Box(low, jnp.asarray([1.2, 1.6, 2.0, 0.8, 2.5, 9.0, 1.0, 1.0], self.gravity.dtype))

    @property
    @override
    def action_space(self) -> Box:
        """Commands of the main engine and of the side engines.

        The main engine is off below 0; commands from 0 to 1 give half to full power. The side engines are off
        between -0.5 and 0.5; a positive command pushes to the right.
        """
        one = jnp.ones((2,), self.gravity.dtype)
        return Box(-one, one)

    @override
    def reset(self, key: Key[Array, ""]) -> LanderState:
        key_heights, key_push = jax.random.split(key)
        dtype = self.gravity.dtype
        heights = jax.random.uniform(
            key_heights, (geometry.NUM_HEIGHTS + 1,), dtype, 0.0, 0.5 * geometry.HEIGHT
        )
        push = self.max_push * jax.random.uniform(key_push, (2,), dtype, -1.0, 1.0)
        return dynamics.step(dynamics.reset(push, dynamics.smooth_terrain(heights)), self.gravity)

    @override
    def observe(self, state: LanderState) -> Float[Array, "8"]:
        x, y = state.origin
        horizontal, vertical = state.hull_velocity
        numbers = [
            (x - geometry.ORIGIN[0]) / geometry.UNITS[0],
            (y - geometry.ORIGIN[1]) / geometry.UNITS[1],
            horizontal * geometry.UNITS[0] * geometry.TIME_STEP,
            vertical * geometry.UNITS[1] * geometry.TIME_STEP,
            state.angle,
            state.spin * 20.0 * geometry.TIME_STEP,
        ]
        return jnp.concatenate([jnp.stack(numbers), state.contacts.astype(x.dtype)])

    @override
    def advance(self, key: Key[Array, ""], state: LanderState, action: Float[Array, "2"]) -> LanderState:
        """The state after the impulses of the engines and one step of the dynamics."""
        noise = self.dispersion * jax.random.uniform(key, (2,), self.gravity.dtype, -1.0, 1.0)
        main, side = _powers(action)
        fired = dynamics.apply_engines(state, self.main_power * main, self.side_power * side, noise)
        return dynamics.step(fired, self.gravity)

    @override
    def is_goal(self, state: LanderState) -> Bool[Array, ""]:
        x, y = self.observe(state)[:2]
        in_box = jnp.maximum(jnp.abs(x), jnp.abs(y)) < self.goal_distance
        return jnp.where(self.goal.is_("box"), in_box, jnp.sqrt(x * x + y * y) < self.goal_distance)

    @override
    def is_failure(self, state: LanderState) -> Bool[Array, ""]:
        return dynamics.hull_touches_ground(state) | (jnp.abs(self.observe(state)[0]) >= 1.0)

    @override
    def has_diverged(self, state: LanderState) -> Bool[Array, ""]:
        fastest = jnp.maximum(jnp.max(jnp.abs(state.velocity)), jnp.abs(state.spin))
        return ~jnp.all(jnp.isfinite(self.observe(state))) | (fastest > self.max_speed)

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        main, side = _powers(step.action)
        fuel = 0.3 * main + 0.03 * jnp.abs(side)
        paid = self._shaping(step.after) - self._shaping(step.state) - fuel
        is_still = step.after.num_still >= _REST_STEPS
        paid = jnp.where(step.failure, jnp.full_like(paid, -100.0), paid)
        paid = jnp.where(is_still, jnp.full_like(paid, 100.0), paid)
        published, ends = penalties(step, -100.0, paid.dtype)
        is_gym = self.classic_reward.is_("gym")
        return jnp.where(is_gym, paid, published), jnp.where(is_gym, step.failure | is_still, ends)

    @override
    def frame(self, state: LanderState) -> Float[Array, "13"]:
        """Joint angles of the legs, and the heights of the terrain."""
        return jnp.concatenate([state.legs, state.terrain])

    def _shaping(self, state: LanderState) -> Float[Array, ""]:
        x, y, horizontal, vertical, angle, _, *contacts = self.observe(state)
        away = jnp.sqrt(x * x + y * y) + jnp.sqrt(horizontal**2 + vertical**2) + jnp.abs(angle)
        return 10.0 * sum(contacts) - 100.0 * away


def _powers(action: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Signed powers of the main and the side engines in [-1, 1]; 0 within the dead zones."""
    main, side = action
    off = jnp.zeros_like(main)
    return jnp.where(main > 0.0, 0.5 * (1.0 + main), off), jnp.where(jnp.abs(side) > 0.5, side, off)
