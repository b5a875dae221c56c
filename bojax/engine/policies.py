"""What a run has learned, as a function that can be called in any loop."""

from itertools import count
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.config.external import resolve
from bojax.config.files import EXPERIMENT
from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.engine.devices import on_cpu, same_draws
from bojax.envs.base import Env
from bojax.envs.spaces import Box
from bojax.experiments.learning import LearningRun
from bojax.experiments.settings import Learning
from bojax.learning.base import LearnerState
from bojax.models.checks import check_count
from bojax.numerics.trial import Misfit
from bojax.results.store import ResultsError


class Policy:
    """What a run has learned, without exploration: a function of an observation that returns an action.

    Observations and actions are those of the environment: for a Gymnasium environment, those that its `reset`
    and `step` return and take. It computes on the CPU, in the precision of the experiment, and changes no
    setting of JAX. It does not learn.

    Args:
        experiment: The experiment of the run.
        state: The exported state of its learner.
        seed: Seed of the random draws of the policy, which break ties or propose candidate actions.
            With equal seeds, equal calls in equal order give equal actions.

    Attributes:
        env: The environment that it was learned in.
    """

    def __init__(self, experiment: LearningRun, state: LearnerState, seed: int = 0):
        check_seed(seed)
        self.env: Env = experiment.env
        self._adapter = experiment.env.adapter()
        space = experiment.env.observation_space
        self._dtype = space.low.dtype if isinstance(space, Box) else jnp.int32
        with jax.enable_x64(True), same_draws():
            key, exploration = jax.random.key(seed), experiment.exploiting
        learner, self._numbers = experiment.learner, count()

        @eqx.filter_jit
        def act(number, observation):
            return learner.act(jax.random.fold_in(key, number), state, observation, exploration)

        self._act = act

    def __call__(self, observation: Any) -> Any:
        """The action to take.

        Raises:
            ValueError: The observation does not fit the space of observations, or is not finite.
        """
        return self.act(observation)[0]

    def act(self, observation: Any) -> tuple[Any, float]:
        """The action to take, and the return that the learner expects of it.

        Raises:
            ValueError: The observation does not fit the space of observations, or is not finite.
        """
        try:
            seen = self._adapter.observation(observation)
        except Misfit as error:
            raise ValueError(str(error)) from None
        if not np.all(np.isfinite(seen)):
            raise ValueError(f"the observation is {seen.tolist()}; allowed: finite numbers")
        with on_cpu(), jax.enable_x64(True), same_draws():
            action, expected = jax.device_get(
                self._act(jnp.asarray(next(self._numbers), jnp.int32), jnp.asarray(seen, self._dtype))
            )
        return self._adapter.action(action), float(expected)


def check_seed(seed: int) -> None:
    """Raise a ValueError unless a seed is one that a config may have."""
    if check_count("seed", seed, 0) >= 2**32:
        raise ValueError(f"seed: got {seed}; allowed: < 2^32")


def saved_policy(folder: Path, run: int, seed: int = 0) -> Policy:
    """The policy of a saved learner, from its folder `learners/POINT`.

    Raises:
        ResultsError: No learner is saved there, or none of this run, or it is damaged.
        ConfigError: This version cannot read its settings.
    """
    if not folder.is_dir():
        raise ResultsError(f"{folder}: no learner was saved; allowed: results of record.learners=true")
    config = resolve(load_config(str(folder), [f"saved_run={run}"])).points[0].config
    if not isinstance(config, Learning):
        raise ResultsError(f"{folder}: got the experiment {config.label}; allowed: learning")
    if config.saved is None:
        raise ResultsError(f"{folder / EXPERIMENT}: saved: got null; allowed: the folder of saved learners")
    with on_cpu(), jax.enable_x64(True):
        experiment = build(config, config.dtype)
    return Policy(experiment, experiment.saved, seed)
