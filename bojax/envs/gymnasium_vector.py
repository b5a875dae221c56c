"""Environments of bojax as a vector environment of Gymnasium: all lanes in one compiled step."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key
from typing_extensions import override

from bojax.config.extras import needed
from bojax.envs.base import Action, Env
from bojax.envs.check import interface_env
from bojax.envs.gymnax import Episode, GymnaxEnv

with needed("gymnasium", "gym"):
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

    from bojax.envs.gymnasium_spaces import as_action, to_gymnasium


class GymnasiumVectorEnv(VectorEnv):
    """Several lanes of an environment of bojax, with the interface of Gymnasium.

    Lanes whose episode has ended are reset in the same step (`AutoresetMode.SAME_STEP`): `step` returns the
    first observation of the next episode, and `info["final_obs"]` the last one of the episode that has ended,
    in the lanes of the mask `info["_final_obs"]`. An episode is truncated after the environment's
    `max_steps`. `info["success"]` says which lanes have reached the goal in this step.

    Lane i of `reset(seed=s)` is the same for every number of lanes; with a list of seeds, each lane follows
    from its own. Observations are 32-bit numbers. All lanes share the properties that `Env.of_run` draws, see
    `GymnasiumEnv`.

    Attributes:
        env: The environment of one lane.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, env: Env, num_envs: int):
        if num_envs < 1:
            raise ValueError(f"num_envs: got {num_envs}; allowed: >= 1")
        self.env = interface_env(env)
        self.num_envs = num_envs
        self.single_observation_space = to_gymnasium(env.observation_space)
        self.single_action_space = to_gymnasium(env.action_space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._keys: Key[Array, "N"] | None = None
        self._episodes: Any = None
        self._num_steps = 0

    @override
    def reset(self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None):
        """Begin an episode in every lane.

        Without a seed, the episodes follow from the seed of an earlier reset. Options are ignored, but for a
        `reset_mask` that leaves lanes out.

        Raises:
            ValueError: The number of seeds is not that of the lanes, or some lanes are to go on.
        """
        if not np.all((options or {}).get("reset_mask", True)):
            raise ValueError(
                "options: got reset_mask; a lane is only reset at the end of its episode, by step"
            )
        if seed is None or isinstance(seed, int | np.integer):
            super().reset(seed=None if seed is None else int(seed))
            key = jax.random.key(int(self.np_random.integers(2**31) if seed is None else seed))
            keys = jax.vmap(lambda lane: jax.random.fold_in(key, lane))(jnp.arange(self.num_envs))
        elif len(seed) != self.num_envs:
            raise ValueError(f"seed: got {len(seed)} seeds; allowed: {self.num_envs}, one for each lane")
        else:
            self.np_random = np.random.default_rng(seed)
            keys = jax.vmap(jax.random.key)(jnp.asarray(seed))
        self._keys, self._num_steps = keys, 0
        observations, self._episodes = _reset(self.env, keys)
        return self._shown(observations), {}

    @override
    def step(self, actions: Any):
        """Take a step in every lane.

        Raises:
            ValueError: There are not as many actions as lanes, or one has not the shape of the action space,
                or is no element of a discrete one.
        """
        if self._keys is None:
            raise gymnasium.error.ResetNeeded("reset() comes before step()")
        actions = as_action(self.env.action_space, actions, self.num_envs)
        self._num_steps += 1
        number = jnp.asarray(self._num_steps, jnp.int32)
        observations, self._episodes, rewards, done, info = _step(
            self.env, self._keys, number, self._episodes, actions
        )
        told = {"success": np.asarray(info["success"]), "_success": np.ones(self.num_envs, bool)}
        if np.any(done):
            told |= {"final_obs": self._shown(info["final_observation"]), "_final_obs": np.asarray(done)}
        return (
            self._shown(observations),
            np.asarray(rewards, np.float64),
            np.asarray(info["terminated"]),
            np.asarray(info["truncated"]),
            told,
        )

    def _shown(self, observations: Array) -> np.ndarray:
        return np.asarray(observations, self.single_observation_space.dtype)


@eqx.filter_jit
def _reset(env: Env, keys: Key[Array, "N"]) -> tuple[Array, Episode]:
    return jax.vmap(lambda key: GymnaxEnv(env).reset(jax.random.fold_in(key, 0)))(keys)


@eqx.filter_jit
def _step(env: Env, keys: Key[Array, "N"], number: Int[Array, ""], episodes: Episode, actions: Action):
    def step(key: Key[Array, ""], episode: Episode, action: Action):
        return GymnaxEnv(env).step(jax.random.fold_in(key, number), episode, action)

    return jax.vmap(step)(keys, episodes, actions)
