"""Environments of bojax with the interface of gymnax, without a dependency on gymnax."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.envs.base import Action, Env, EnvState, Observation
from bojax.envs.check import interface_env
from bojax.envs.spaces import Box, Space


class Episode(eqx.Module):
    """The state of an environment within an episode.

    Attributes:
        state: State of the environment.
        time: Number of steps since the reset.
    """

    state: EnvState
    time: Int[Array, ""]


class GymnaxSpace(eqx.Module):
    """A space with the attributes of gymnax's spaces.

    Attributes:
        n: Number of elements of a discrete space; None for a box.
        low: Lower bounds of a box; 0 for a discrete space.
        high: Upper bounds, which belong to the space.
        shape: Shape of an element.
        dtype: Data type of an element.
    """

    n: int | None = eqx.field(static=True)
    low: Array
    high: Array
    shape: tuple[int, ...] = eqx.field(static=True)
    dtype: Any = eqx.field(static=True)

    def sample(self, key: Key[Array, ""]) -> Array:
        """A uniform draw."""
        if self.n is not None:
            return jax.random.randint(key, self.shape, 0, self.n, self.dtype)
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: Array) -> Bool[Array, ""]:
        """Whether an element lies within the bounds."""
        return jnp.all((x >= self.low) & (x <= self.high))


class GymnaxEnv:
    """The interface of gymnax before version 1.0.

    The parameters of gymnax, which can be batched and swept, are the environment itself: every number of a
    `bojax.envs.base.Env` is an array leaf. After the last step of an episode, `step` returns the first
    observation and state of the next one. The function is not compiled; the caller compiles the loop. The
    default parameters have the properties that `Env.of_run` draws from key 0.

    Attributes:
        default_params: The environment.
    """

    def __init__(self, env: Env):
        self.default_params = interface_env(env)

    @property
    def name(self) -> str:
        """Name of the environment's class."""
        return type(self.default_params).__name__

    @property
    def num_actions(self) -> int:
        """Number of actions, or of dimensions of an action."""
        return self.default_params.action_space.num_units

    def observation_space(self, params: Env | None = None) -> GymnaxSpace:
        """Declared bounds of observations; observations may lie outside them."""
        return _space((params or self.default_params).observation_space)

    def action_space(self, params: Env | None = None) -> GymnaxSpace:
        """Bounds of actions."""
        return _space((params or self.default_params).action_space)

    def reset(self, key: Key[Array, ""], params: Env | None = None) -> tuple[Observation, Episode]:
        """The first observation and the state of an episode."""
        env = params or self.default_params
        state = env.reset(key)
        return env.observe(state), Episode(state, jnp.zeros((), jnp.int32))

    def step(
        self, key: Key[Array, ""], state: Episode, action: Action, params: Env | None = None
    ) -> tuple[Observation, Episode, Float[Array, ""], Bool[Array, ""], dict[str, Scalar | Array]]:
        """Observation, state, reward, whether the episode has ended, and information.

        The information tells how the step ended: `terminated`, `truncated` (by the environment or its
        `max_steps`), `success`, `discount` (0 if terminated, else 1), and `final_observation`, the
        observation before the reset, which equals the first result while the episode continues.
        """
        env = params or self.default_params
        key_step, key_reset = jax.random.split(key)
        after, result = env.step(key_step, state.state, action)
        time = state.time + 1
        truncated = result.truncated | ((time >= env.max_steps) & ~result.terminated)
        done = result.terminated | truncated
        going_on = result.observation, Episode(after, time)
        observation, episode = jax.tree.map(
            lambda new, old: jnp.where(done, new, old), self.reset(key_reset, params), going_on
        )
        info = {
            "terminated": result.terminated,
            "truncated": truncated,
            "success": result.success,
            "discount": 1.0 - result.terminated.astype(result.reward.dtype),
            "final_observation": result.observation,
        }
        return observation, episode, result.reward, done, info


def _space(space: Space) -> GymnaxSpace:
    if isinstance(space, Box):
        return GymnaxSpace(None, space.low, space.high, space.low.shape, space.low.dtype)
    zero = jnp.zeros((), jnp.int32)
    return GymnaxSpace(space.num, zero, zero + space.num - 1, (), zero.dtype)
