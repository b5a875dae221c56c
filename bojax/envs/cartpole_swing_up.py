"""Swing a pole up by moving the cart it hangs from (thesis, p. 107): Gym's CartPole, started hanging."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlStep, ControlTask, sign, symmetric
from bojax.envs.spaces import Box
from bojax.numerics.choices import Choice, one_of

_GRAVITY, _CART, _POLE, _HALF_LENGTH = 9.8, 1.0, 0.1, 0.5


class CartpoleSwingUp(ControlTask):
    """A pole on a cart on a track; its state is the observation.

    The cart weighs 1 kg, and the pole 0.1 kg over a length of 1 m. The equations of motion follow Gym's
    CartPole (Barto, Sutton and Anderson, 1983, without friction), with its explicit Euler step. The angle is
    measured from upright and is not wrapped.

    The goal is a cosine of the angle above `goal_cosine`, at any speed; the failure is to leave the track,
    |x| > `limit`. The classic reward is the author's: cosine - 1 a step, 0 at the goal and -100
    at the failure, both of which end the episode.

    An episode begins with the pole hanging: all four numbers are uniform in [-0.05, 0.05], around an angle of
    pi.

    Settings: `bojax.envs.settings.CartpoleSwingUp`.
    """

    goal_cosine: Float[Array, ""]
    limit: Float[Array, ""]
    max_force: Float[Array, ""]
    time_step: Float[Array, ""]
    max_steps: int = eqx.field(static=True)
    actions: Choice = eqx.field(converter=one_of("continuous", "sign"))

    @property
    @override
    def observation_space(self) -> Box:
        """Position in metres and velocity of the cart, angle in radians and velocity of the pole."""
        dtype = self.limit.dtype
        low = jnp.asarray([-3.4, -8.0, -5.4, -8.7], dtype)
        return Box(low, jnp.asarray([3.4, 8.3, 6.35, 8.1], dtype))

    @property
    @override
    def action_space(self) -> Box:
        """The force on the cart, in N."""
        return symmetric(self.max_force)

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        state = jax.random.uniform(key, (4,), self.limit.dtype, -0.05, 0.05)
        return state.at[2].add(jnp.pi)

    @override
    def advance(
        self, key: Key[Array, ""], state: Float[Array, "4"], action: Float[Array, "1"]
    ) -> Float[Array, "4"]:
        """One explicit Euler step."""
        (force,) = action
        force = jnp.where(self.actions.is_("sign"), self.max_force * sign(force), force)
        _, velocity, angle, speed = state
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        push = (force + _POLE * _HALF_LENGTH * speed**2 * sine) / (_CART + _POLE)
        inertia = _HALF_LENGTH * (4.0 / 3.0 - _POLE * cosine**2 / (_CART + _POLE))
        turn = (_GRAVITY * sine - cosine * push) / inertia
        acceleration = push - _POLE * _HALF_LENGTH * turn * cosine / (_CART + _POLE)
        return state + self.time_step * jnp.stack([velocity, acceleration, speed, turn])

    @override
    def is_goal(self, state: Float[Array, "4"]) -> Bool[Array, ""]:
        return jnp.cos(state[2]) > self.goal_cosine

    @override
    def is_failure(self, state: Float[Array, "4"]) -> Bool[Array, ""]:
        return jnp.abs(state[0]) > self.limit

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        paid = jnp.where(step.success, jnp.zeros_like(step.after[2]), jnp.cos(step.after[2]) - 1.0)
        return jnp.where(step.failure, jnp.full_like(paid, -100.0), paid), step.success | step.failure
