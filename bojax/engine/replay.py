"""Recorded episodes of Gymnasium environments, stepped again for their pictures."""

import os
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from bojax.engine.batch import run_key
from bojax.engine.build import build
from bojax.engine.hosted import seed_of
from bojax.envs.settings import Gymnasium
from bojax.envs.spaces import Discrete
from bojax.experiments.learning_episodes import reset_key, shares_start
from bojax.results.store import ResultsError

PICTURE = "rgb_array"
"""Gymnasium's name of pictures as arrays."""


class Replay:
    """A training episode of a Gymnasium environment, from its seed and its recorded actions.

    Episodes count from 1; `starts` is the setting of the experiment.

    Raises:
        ResultsError: The environment draws no pictures.
        ConfigError: The environment cannot be made.
    """

    def __init__(
        self,
        env: Gymnasium,
        dtype: Literal["float64", "float32"],
        seed: int,
        run: int,
        episode: int,
        starts: Literal["per-episode", "per-run"],
    ):
        with jax.enable_x64(True):
            host = build(env, dtype)
            key = run_key(jax.random.key(seed), jnp.asarray(run, jnp.int32))
            number = jnp.asarray(episode, jnp.int32)
            self._seed = int(seed_of(reset_key(key, number, 0, shares_start(starts))))
        # Most of them draw with pygame, which then opens no window.
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        modes = host.make().metadata.get("render_modes") or []
        if PICTURE not in modes:
            known = ", ".join(map(str, modes)) or "none"
            raise ResultsError(f"{env.id} draws no pictures: its render modes are {known}, without {PICTURE}")
        self._id, self._is_discrete = env.id, isinstance(host.action_space, Discrete)
        self._env = host.make(render_mode=PICTURE)
        fps = self._env.metadata.get("render_fps")
        self.seconds = 1.0 / fps if fps else 0.0  # of a step; 0 if the environment has no `render_fps`
        self.observation: Any = None

    def begin(self) -> None:
        """Reset the environment to the start of the episode."""
        self.observation, _ = self._env.reset(seed=self._seed)

    def picture(self) -> NDArray[np.uint8]:
        """What the environment draws, `[height, width, 3]`.

        Raises:
            ResultsError: It draws something else.
        """
        found = np.asarray(self._env.render())
        if found.ndim != 3 or found.shape[-1] != 3 or found.dtype != np.uint8:
            got = f"{found.dtype} of shape {found.shape}"
            raise ResultsError(f"{self._id} draws {got}; allowed: uint8 of shape (height, width, 3)")
        return found

    def step(self, action: NDArray[np.float64]) -> None:
        """Take a recorded action, `[A]`."""
        self.observation, *_ = self._env.step(int(action[0]) if self._is_discrete else action)

    def close(self) -> None:
        """Close the environment."""
        self._env.close()
