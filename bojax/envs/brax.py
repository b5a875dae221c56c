"""Brax environments for bojax, compiled; and environments of bojax for Brax, as for `brax.training`."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.envs.base import Env, TimeStep
from bojax.envs.check import interface_env
from bojax.envs.spaces import Box
from bojax.numerics.third_party import plain_jax, silenced, standard_jax

with silenced():
    import brax.envs as brax_envs


class BraxEnv(Env):
    """An environment of Brax, given by its name; its state has 32-bit numbers at any precision.

    A state that Brax calls done is terminal; Brax's time limit is not used. Actions range from -1 to 1, as in
    Brax. The name may have been registered by `brax.envs.register_environment`.

    Settings: `bojax.envs.settings.Brax`.
    """

    low: Float[Array, "..."]
    high: Float[Array, "..."]
    success_reward: Float[Array, ""] | None
    name: str = eqx.field(static=True)
    backend: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    observation_size: int = eqx.field(static=True, init=False)
    action_size: int = eqx.field(static=True, init=False)

    def __post_init__(self):
        """Create the environment and check its observations.

        Raises:
            ValueError: There is no environment of this name or backend; its observations are not vectors; a
                bound has the wrong size, or a lower bound is not below the upper one.
        """
        if self.name not in brax_envs._envs:
            raise ValueError(
                f'name: got "{self.name}"; Brax has no such environment; it has: '
                + ", ".join(sorted(brax_envs._envs))
            )
        observation, self.action_size = _sizes(self.name, self.backend)
        if not hasattr(observation, "shape") or len(observation.shape) != 1:
            raise ValueError(f'name: got "{self.name}"; its observations are not a vector of numbers')
        (self.observation_size,) = observation.shape
        for name, bound in (("low", self.low), ("high", self.high)):
            if bound.ndim and bound.shape != (self.observation_size,):
                raise ValueError(
                    f"{name}: got {bound.size} numbers; {self.name} has {self.observation_size} observations"
                )
        if not np.all(np.asarray(self.low) < np.asarray(self.high)):
            raise ValueError("low: allowed: < high in every component")

    @property
    @override
    def observation_space(self) -> Box:
        """The declared bounds of the observations."""
        shape = (self.observation_size,)
        return Box(jnp.broadcast_to(self.low, shape), jnp.broadcast_to(self.high, shape))

    @property
    @override
    def action_space(self) -> Box:
        """The interval from -1 to 1 for each actuator."""
        one = jnp.ones((self.action_size,), self.low.dtype)
        return Box(-one, one)

    @override
    def reset(self, key: Key[Array, ""]) -> Any:
        return standard_jax(_created(self.name, self.backend).reset)(key)

    @override
    def observe(self, state: Any) -> Float[Array, "D"]:
        return state.obs.astype(self.low.dtype)

    @override
    def step(self, key: Key[Array, ""], state: Any, action: Float[Array, "A"]) -> tuple[Any, TimeStep]:
        # A Brax environment keeps a key in its state.
        del key
        action = jnp.clip(action, -jnp.ones_like(action), jnp.ones_like(action))
        state = standard_jax(_created(self.name, self.backend).step)(state, action)
        reward = state.reward.astype(self.low.dtype)
        done = state.done > 0.5
        never = jnp.zeros_like(done)
        success = never if self.success_reward is None else reward >= self.success_reward
        return state, TimeStep(self.observe(state), reward, done, never, success)


class BojaxEnv(brax_envs.Env):
    """An environment of bojax with the interface of Brax.

    Actions range from -1 to 1, which are mapped to the bounds. Brax has a single flag `done`, set if a step
    terminates or truncates the episode; Brax applies the time limit (`episode_length`). The metric `success`
    is 1 in the first step of an episode that reaches the goal, so that its sum over an episode, which Brax
    reports, is 0 or 1 even if the episode continues at the goal. All episodes share the properties that
    `Env.of_run` draws from key 0; pass `env.of_run(key)` to draw them from another key.

    Attributes:
        env: The environment; its observations and actions must be vectors.
    """

    def __init__(self, env: Env):
        """Wrap an environment.

        Raises:
            ValueError: The observations or actions of the environment are discrete.
        """
        observations, actions = env.observation_space, env.action_space
        if not (isinstance(observations, Box) and isinstance(actions, Box)):
            raise ValueError(f"{type(env).__name__}: Brax takes vectors as observations and actions")
        self.env = interface_env(env)
        self._num_observations, self._actions = observations.num_dims, actions

    @override
    def reset(self, rng: jax.Array) -> brax_envs.State:
        own, later = jax.random.split(_typed(rng))
        state = self.env.reset(own)
        observation = self.env.observe(state)
        zero = jnp.zeros((), observation.dtype)
        info = {"key": jax.random.key_data(later)}
        inner: Any = state, zero
        return brax_envs.State(inner, observation, zero, zero, {"success": zero}, info)

    @override
    def step(self, state: brax_envs.State, action: jax.Array) -> brax_envs.State:
        own, later = jax.random.split(_typed(state.info["key"]))
        action = self._actions.from_unit(0.5 * (jnp.clip(action, -1.0, 1.0) + 1.0))
        inner: Any = state.pipeline_state  # which Brax resets at the end of an episode
        before, has_succeeded = inner
        after, transition = self.env.step(own, before, action)
        dtype = transition.reward.dtype
        success = transition.success.astype(dtype)
        inner = after, jnp.maximum(has_succeeded, success)
        return brax_envs.State(
            pipeline_state=inner,
            obs=transition.observation,
            reward=transition.reward,
            done=(transition.terminated | transition.truncated).astype(dtype),
            metrics={**state.metrics, "success": success * (1.0 - has_succeeded)},
            info={**state.info, "key": jax.random.key_data(later)},
        )

    @property
    @override
    def observation_size(self) -> int:
        return self._num_observations

    @property
    @override
    def action_size(self) -> int:
        return self._actions.num_dims

    @property
    @override
    def backend(self) -> str:
        # Brax asks for the name of a physics backend; environments of bojax use none.
        return "bojax"


@functools.cache
def _created(name: str, backend: str) -> brax_envs.Env:
    """The environment, created once and outside any trace."""
    with silenced(), plain_jax(), jax.ensure_compile_time_eval():
        return brax_envs.get_environment(name, backend=backend)


@functools.cache
def _sizes(name: str, backend: str) -> tuple[Any, int]:
    """Shape of an observation, and size of an action; Brax's `observation_size` would run a slow reset."""
    env = _created(name, backend)
    with plain_jax():
        state = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
        return state.obs, env.action_size


def _typed(rng: jax.Array) -> Key[Array, ""]:
    return rng if jnp.issubdtype(rng.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(rng)
