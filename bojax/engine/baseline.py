"""What random actions do in the environment of a run: a table beside the results, which the report draws."""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from bojax.config.errors import say
from bojax.config.points import Sweep
from bojax.engine.batch import run_key
from bojax.engine.build import build
from bojax.envs.base import Env
from bojax.envs.robots.settings import Robot
from bojax.envs.settings import Brax, Gymnasium
from bojax.experiments.random_baseline import random_episodes
from bojax.experiments.settings import Learning
from bojax.learning.settings import RandomActions
from bojax.results.baseline import COLUMNS, FILE
from bojax.results.store import write_table
from bojax.results.tables import to_arrow
from bojax.text import error_line

HOLDS = (1, 8)
"""Numbers of steps for which actions are repeated."""

RUNS = 32  # number of runs for each of `HOLDS`; fewer if all would take more than `MOST_STEPS`
FEWEST_RUNS = 8  # fewer are not worth a curve
BATCH = 4  # runs that one call makes, so that a slow environment is noticed early
MOST_STEPS = 4_000_000
MOST_SECONDS = 20.0
"""Longest time for all runs, as the first call predicts it; there is no baseline if it would take longer."""


def write_baseline(sweep: Sweep, folder: Path) -> None:
    """Write the baseline of a finished learning run into its results folder, unless it is there.

    A learner that does not train or is random has no baseline. Neither has an environment whose steps are
    slow (a robot, or one of Brax or Gymnasium), or whose baseline would take longer than `MOST_SECONDS`.
    A failure is a note, since the results are complete.
    """
    config, path = sweep.points[0].config, folder / FILE
    if not isinstance(config, Learning) or config.saved is not None or path.exists():
        return
    if isinstance(config.learner, RandomActions) or isinstance(config.env, Robot | Brax | Gymnasium):
        return
    try:
        env = build(config.env, config.dtype)
        columns = None if env.is_hosted else _columns(env, config, sweep.seed)
        if columns is not None:
            write_table(path, to_arrow(COLUMNS, columns))
    except Exception as error:  # whatever an environment of the user's raises
        say(f"note: no baseline of random actions: {error_line(error)}")


def _columns(env: Env, config: Learning, seed: int) -> dict[str, np.ndarray] | None:
    """The columns of the table; None if it would take too long."""
    steps_of_run = len(HOLDS) * config.episodes * env.max_steps
    runs = min(RUNS, MOST_STEPS // steps_of_run // BATCH * BATCH)
    if runs < FEWEST_RUNS:
        return None
    lanes = [np.ravel(x) for x in np.meshgrid(np.arange(BATCH), HOLDS, 1 + np.arange(config.episodes))]
    run, hold, number = (x.astype(np.int32) for x in lanes)
    program = jax.jit(lambda *lanes: random_episodes(env, config.starts, *lanes))
    program = program.lower(*_lanes(seed, run, number, hold)).compile()
    found, start = [], time.monotonic()
    for first in range(0, runs, BATCH):
        found.append(jax.device_get(program(*_lanes(seed, first + run, number, hold))))
        if (time.monotonic() - start) * runs > MOST_SECONDS * (first + BATCH):
            say(f"note: no baseline of random actions: it takes over {MOST_SECONDS:g} s")
            return None
    episodes = jax.tree.map(lambda *parts: np.concatenate(parts), *found)
    firsts = np.repeat(np.arange(0, runs, BATCH), len(run))
    columns = {
        "action_repeat": np.tile(hold, runs // BATCH),
        "run": firsts + np.tile(run, runs // BATCH),
        "episode": np.tile(number, runs // BATCH),
        "return": episodes.total,
        "length": episodes.length,
        "success": episodes.success,
    }
    order = np.lexsort([columns[name] for name in ("episode", "run", "action_repeat")])
    return {name: values[order] for name, values in columns.items()}


def _lanes(seed: int, run: np.ndarray, number: np.ndarray, hold: np.ndarray) -> tuple[jax.Array, ...]:
    """The arguments of a batch of episodes: keys of runs, numbers of episodes, steps for each action."""
    keys = jax.vmap(lambda run: run_key(jax.random.key(seed), run))(jnp.asarray(run, jnp.int32))
    return keys, jnp.asarray(number), jnp.asarray(hold)
