"""Gymnasium environments, stepped on the host, for bojax; and environments of bojax for Gymnasium."""

import json
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from bojax.config.errors import note_once
from bojax.config.extras import needed
from bojax.envs.adapter import Adapter
from bojax.envs.base import Env
from bojax.envs.check import interface_env
from bojax.envs.spaces import Space
from bojax.numerics.trial import Misfit
from bojax.text import error_line, one_line

with needed("gymnasium", "gym"):
    import gymnasium
    from gymnasium import spaces
    from gymnasium.error import NameNotFound

    from bojax.envs.gymnasium_spaces import REAL, GymnasiumAdapter, as_action, from_gymnasium, to_gymnasium


_TRIAL_STEPS = 10
"""Largest number of steps, under random actions, that an environment takes before it is accepted."""

_SUCCESS_KEYS = ("is_success", "success")
"""Keys of `info` that tell success: of Gymnasium-Robotics and Stable-Baselines3, and of Meta-World."""


class GymnasiumEnv(gymnasium.Env):
    """An environment of bojax, compiled, with the interface of Gymnasium.

    An episode is truncated after the environment's `max_steps`. All random numbers follow from the seed of
    `reset`. Observations are 32-bit numbers. Random properties that all episodes of a run share, such as a
    hidden target, are drawn once, from key 0; pass `env.of_run(key)` to draw them from another key.

    Attributes:
        env: The environment.
    """

    metadata = {"render_modes": []}

    def __init__(self, env: Env):
        self.env = interface_env(env)
        self.observation_space = to_gymnasium(env.observation_space)
        self.action_space = to_gymnasium(env.action_space)
        self._episode = self._state = None
        self._num_steps = 0

    @override
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin an episode; `options` are ignored."""
        super().reset(seed=seed, options=options)
        self._episode = jax.random.key(int(self.np_random.integers(2**31)))
        self._num_steps = 0
        self._state, observation = _begin(self.env, self._episode)
        return self._shown(observation), {}

    @override
    def step(self, action: Any):
        """Take a step; `info["success"]` says whether the goal was reached.

        Raises:
            ValueError: The action has not the shape of the action space, or is no element of a discrete one.
        """
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("reset() comes before step()")
        action = as_action(self.env.action_space, action)
        self._num_steps += 1
        step = jnp.asarray(self._num_steps, jnp.int32)
        self._state, transition = _step(self.env, self._episode, step, self._state, action)
        terminated = bool(transition.terminated)
        is_last = self._num_steps >= self.env.max_steps and not terminated
        return (
            self._shown(transition.observation),
            float(transition.reward),
            terminated,
            bool(transition.truncated) or is_last,
            {"success": bool(transition.success)},
        )

    def _shown(self, observation: Array) -> Any:
        if isinstance(self.observation_space, spaces.Discrete):
            return int(observation)
        return np.asarray(observation, np.float32)


class HostEnv(Env):
    """An environment of Gymnasium, which steps on the host as one Python object for each lane.

    Observations with several axes or parts are flattened, and discrete spaces count from 0, as
    `bojax.envs.gymnasium_spaces` says. As for every environment, the time limit is `max_steps`. Gymnasium's
    own time limit is removed, so that truncation comes from the environment itself.

    Settings: `bojax.envs.settings.Gymnasium`.
    """

    is_hosted: ClassVar[bool] = True

    low: Float[Array, "..."] | None
    high: Float[Array, "..."] | None
    success_reward: Float[Array, ""]
    id: str = eqx.field(static=True)
    kwargs: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    success: Literal["never", "terminated", "reward", "info"] = eqx.field(static=True)
    success_key: str | None = eqx.field(static=True)
    observations: Space
    actions: Space

    def __init__(
        self,
        low: Float[Array, "..."] | None,
        high: Float[Array, "..."] | None,
        success_reward: Float[Array, ""],
        id: str,
        kwargs: Mapping[str, Any],
        max_steps: int | None,
        success: Literal["never", "terminated", "reward", "info"],
        success_key: str | None,
    ):
        """Create an environment and check that it matches its declarations.

        Raises:
            ValueError: There is no environment of this id, or it cannot be created; a space cannot be a
                vector, or has infinite bounds and no others are given; the environment has no time
                limit and none is given; a few trial steps fail, or return values that Gymnasium's interface
                does not allow, that do not fit the declared space, or that are not finite; `info` is to tell
                success, and does not do so in a trial episode.
        """
        self.low, self.high, self.success_reward = low, high, success_reward
        self.id, self.kwargs, self.success = id, json.dumps(dict(kwargs), sort_keys=True), success
        self.success_key = success_key
        try:
            made = self._made()
            _, _, name = id.rpartition(":")  # `make` has imported the module; `spec` does not know it
            limit = max_steps or gymnasium.spec(name).max_episode_steps
            spaces = made.observation_space, made.action_space
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            is_unknown = isinstance(error, NameNotFound) and ":" not in id
            hint = " (one of your own: MODULE:ID imports its module first)" if is_unknown else ""
            raise ValueError(f'id: got "{id}"; {error_line(error)}{hint}') from error
        dtype = success_reward.dtype
        self.observations = from_gymnasium(spaces[0], "observation", dtype, low, high)
        self.actions = from_gymnasium(spaces[1], "action", dtype)
        if limit is None:
            raise ValueError(
                f"max_steps: got null; allowed: a number, since {id} has no time limit of its own"
            )
        self.max_steps = limit
        has_own_bounds = low is None and high is None
        keys = _try(self._idling(made), id, limit, dtype, has_own_bounds)
        made.close()
        if success == "never" and (told := [key for key in _SUCCESS_KEYS if key in keys]):
            note_once(
                f"note: success: got never, but the info of {id} has {told[0]}, which success: info counts"
            )

    @property
    @override
    def observation_space(self) -> Space:
        """The space that Gymnasium declares, with the bounds of the config if they are set."""
        return self.observations

    @property
    @override
    def action_space(self) -> Space:
        """The space that Gymnasium declares."""
        return self.actions

    def make(self, **changes: Any) -> gymnasium.Env:
        """A new environment, wrapped by `Idling`, with changes of its `kwargs`."""
        return self._idling(self._made(**changes))

    def make_vector(self, num: int) -> gymnasium.vector.SyncVectorEnv:
        """Several environments, stepped together; each waits after its episode for a reset with a seed."""
        return gymnasium.vector.SyncVectorEnv([self.make] * num)

    def is_success(
        self, reward: Float[Array, "*N"], terminated: Bool[Array, "*N"], told: Bool[Array, "*N"]
    ) -> Bool[Array, "*N"]:
        """Whether steps with these rewards, terminations, and successes told by `info` are successes."""
        if self.success == "terminated":
            return terminated
        if self.success == "reward":
            return reward >= self.success_reward.astype(reward.dtype)
        if self.success == "info":
            return told
        return jnp.zeros_like(terminated)

    @override
    def adapter(self) -> Adapter:
        made = self._made()
        found = GymnasiumAdapter((made.observation_space, made.action_space), self.observations, self.actions)
        made.close()
        return found

    @override
    def reset(self, key):
        """Not available: the environment is stepped on the host, see `make_vector`.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"{self.id} is stepped on the host and cannot be compiled: use make_vector")

    @override
    def observe(self, state):
        """Not available, see `reset`."""
        return self.reset(state)

    @override
    def step(self, key, state, action):
        """Not available, see `reset`."""
        return self.reset(key)

    def _idling(self, made: gymnasium.Env) -> "Idling":
        keys = (self.success_key,) if self.success_key else _SUCCESS_KEYS
        return Idling(made, self.observations, self.actions, keys if self.success == "info" else ())

    def _made(self, **changes: Any) -> gymnasium.Env:
        if ":" in self.id and str(Path.cwd()) not in sys.path:  # an installed command lacks this entry
            sys.path.insert(0, str(Path.cwd()))
        kwargs = json.loads(self.kwargs) | changes
        return gymnasium.make(self.id, max_episode_steps=-1, disable_env_checker=True, **kwargs)


class Idling(gymnasium.Wrapper):
    """A wrapper with flat observations and actions that stays at the end of an episode until it is seeded.

    Neither a step nor a reset without a seed changes it. A vector environment resets every environment whose
    episode has ended, but the next episode must not begin before the episodes of all lanes have ended.

    A `Misfit` is raised by a reset or a step that returns something else than Gymnasium's interface says: by
    environments of the interface before Gymnasium 0.26, or if the observation does not fit its space.

    Attributes:
        success_keys: The `info` of a step has only `success`, and only if the environment's has one of these
            keys; the first one counts.
        told: Keys of the environment's `info` in the last step.
    """

    def __init__(
        self, env: gymnasium.Env, observations: Space, actions: Space, success_keys: tuple[str, ...] = ()
    ):
        super().__init__(env)
        self.success_keys, self.told = success_keys, ()
        self._adapter = GymnasiumAdapter((env.observation_space, env.action_space), observations, actions)
        self.observation_space = to_gymnasium(observations)
        self.action_space = to_gymnasium(actions)
        self._last: Any = None
        self._has_ended = False

    @override
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin an episode; without a seed, an environment whose episode has ended stays as it is."""
        if self._has_ended and seed is None:
            return self._last, {}
        result: Any = self.env.reset(seed=seed, options=options)
        if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Mapping)):
            raise self._misfit(f"reset returns {_counted(result)}; allowed: an observation and a dictionary")
        self._has_ended, self._last = False, self._plain("reset", result[0])
        return self._last, {}

    @override
    def step(self, action: Any):
        """Take a step; after the end of the episode, repeat the last observation."""
        if self._has_ended:
            return self._last, 0.0, False, False, {}
        result: Any = self.env.step(self._adapter.action(action))
        if not (isinstance(result, tuple) and len(result) == 5):
            names = "observation, reward, terminated, truncated, info"
            raise self._misfit(f"step returns {_counted(result)}; allowed: 5 ({names})")
        observation, reward, terminated, truncated, info = result
        if (shape := np.shape(reward)) != ():
            raise self._misfit(f"step returns a reward of shape {shape}, not one number")
        if np.asarray(reward).dtype.kind not in REAL:
            raise self._misfit(f"step returns a reward of type {type(reward).__name__}; allowed: a number")
        for name, flag in (("terminated", terminated), ("truncated", truncated)):
            if np.shape(flag) != () or np.asarray(flag).dtype.kind != "b":
                raise self._misfit(f"step returns {name} as {type(flag).__name__}; allowed: True or False")
        if not isinstance(info, Mapping):
            raise self._misfit(f"step returns info as {type(info).__name__}; allowed: a dictionary")
        self._last, self._has_ended = self._plain("step", observation), bool(terminated or truncated)
        return self._last, float(reward), bool(terminated), bool(truncated), self._success(info)

    def _success(self, info: Mapping[str, Any]) -> dict[str, bool]:
        """The value of the first success key that `info` has, under the name `success`."""
        self.told = tuple(info)
        for key in self.success_keys:
            if key in info:
                value = info[key]
                if np.shape(value) != () or np.asarray(value).dtype.kind not in REAL or value not in (0, 1):
                    got = one_line(repr(value))
                    raise self._misfit(f'step returns info["{key}"] as {got}; allowed: True or False')
                return {"success": bool(value)}
        return {}

    def _plain(self, method: str, observation: Any) -> Any:
        """The observation that a method returned, as an integer from 0 or a vector."""
        try:
            return self._adapter.observation(observation, f"{method} returns")
        except Misfit as error:
            raise self._misfit(str(error)) from error

    def _misfit(self, message: str) -> Misfit:
        name = self.spec.id if self.spec else type(self.unwrapped).__name__
        return Misfit(f"{name}: {message}")


def _counted(result: Any) -> str:
    """What a method returned, for messages: the number of values, or the type of a single one."""
    return f"{len(result)} values" if isinstance(result, tuple) else f"one {type(result).__name__}"


def _try(env: Idling, id: str, limit: int, dtype: Any, has_own_bounds: bool) -> Collection[str]:
    """Check observations and rewards of a few steps under random actions, and that success is reported.

    `limit` is the number of steps of an episode, and `dtype` the precision of the rewards; with
    `has_own_bounds`, all bounds of observations are those that the environment declares. Returns the keys of
    `info` in these steps.
    """
    env.action_space.seed(0)
    space, where, has_ended = env.observation_space, "reset", False
    is_told, names, number = not env.success_keys, dict[Any, None](), 0
    for number in range(limit + 1):
        reward, told = 0.0, {}
        try:
            # What overflows in the precision of a run is refused below, without NumPy's warning.
            with np.errstate(over="ignore"):
                if number == 0:
                    observation = np.array(env.reset(seed=0)[0])
                    if not np.array_equal(observation, env.reset(seed=0)[0], equal_nan=True):
                        note_once(
                            f"note: {id}: two resets with one seed differ, so that no run can be repeated"
                        )
                else:
                    where = f"step {number}"
                    observation, reward, *ends, told = env.step(env.action_space.sample())
                    has_ended = any(ends)
                finite = np.isfinite(np.asarray(reward, dtype)), np.isfinite(observation)
        except Misfit as error:
            raise ValueError(str(error)) from error
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise ValueError(f"{id} fails in {where}: {error_line(error)}") from error
        for what, is_finite in zip(("reward", "observation"), finite, strict=True):
            if not np.all(is_finite):
                raise ValueError(f"{id}: the {what} of {where} is not finite in the precision of the run")
        if has_own_bounds and isinstance(space, spaces.Box):
            outside = (observation < space.low) | (observation > space.high)
            if outside.any():
                at = ", ".join(map(str, np.flatnonzero(outside)))
                remedy = "set low and high"
                raise ValueError(
                    f"{id}: the observation of {where} is out of bounds (component {at}): {remedy}"
                )
        is_told = is_told or bool(told)
        names |= dict.fromkeys(env.told)
        # Some environments tell success in the last step only.
        if has_ended or (number >= _TRIAL_STEPS and is_told):
            break
    if not is_told:
        wanted = " or ".join(env.success_keys)
        found = f"but {one_line(', '.join(map(str, names)))}" if names else "which is empty"
        raise ValueError(
            f"success: got info; {id} has no {wanted} in the info of an episode of {number} steps, "
            f"{found}; set success_key, or let each step tell it, also as False"
        )
    return names.keys()


@eqx.filter_jit
def _begin(env: Env, episode: Array) -> tuple[Any, Array]:
    state = env.reset(jax.random.fold_in(episode, 0))
    return state, env.observe(state)


@eqx.filter_jit
def _step(env: Env, episode: Array, step: Array, state: Any, action: Array):
    return env.step(jax.random.fold_in(episode, step), state, action)
