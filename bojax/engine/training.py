"""Training from Python: runs of a learner in an environment, without files.

Sweeps, target returns, checkpoints and reports are features of the command line only.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Annotated, Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pydantic

from bojax.config.catalog import roles
from bojax.config.component import Component, Slot
from bojax.config.errors import dotted, from_validation
from bojax.engine.batch import Compiled
from bojax.engine.build import build, import_target
from bojax.engine.devices import LANES_ON_ACCELERATOR, choose_lanes, make_mesh
from bojax.engine.groups import static_groups
from bojax.engine.hosted import Hosted
from bojax.engine.segments import fetch_rows
from bojax.envs.base import Env
from bojax.envs.spaces import Box
from bojax.experiments.learning import LearningRun
from bojax.learning.base import Learner, LearnerState
from bojax.learning.schedules import Schedule
from bojax.results.tables import KEYS, sort_rows, to_arrow

Settings: TypeAlias = str | Mapping[str, Any] | Component
"""A built-in part as in a config file: its kind, its kind with settings, or its schema class."""


@dataclass(frozen=True)
class Training:
    """The results of `train`.

    Attributes:
        runs: One row for each run, as in `runs.parquet`.
        episodes: One row for each episode, as in `episodes.parquet`.
        experiment: The experiment, with its environment and learner.
        learned: Exported state of the learner of each run, in arrays `[runs, ...]`.
    """

    runs: pa.Table
    episodes: pa.Table
    experiment: LearningRun
    learned: LearnerState

    def policy(self, run: int = 0, seed: int = 0) -> Callable[[Any], np.ndarray]:
        """The policy that a run has learned, without exploration: a NumPy function of the observation.

        Args:
            run: Index of the run.
            seed: Seed of the random draws of the policy, which break ties or propose candidate actions.
        """
        state = jax.tree.map(lambda leaf: leaf[run], self.learned)
        space = self.experiment.env.observation_space
        dtype = space.low.dtype if isinstance(space, Box) else jnp.int32
        act = eqx.filter_jit(self.experiment.learner.act)
        exploiting, key, numbers = self.experiment.exploiting, jax.random.key(seed), count()

        def choose(observation: Any) -> np.ndarray:
            seen = jnp.asarray(observation, dtype)
            seen = seen.ravel() if isinstance(space, Box) else seen
            return np.asarray(act(jax.random.fold_in(key, next(numbers)), state, seen, exploiting)[0])

        return choose


def train(
    env: Env | Settings,
    learner: Learner | Settings,
    *,
    episodes: int = 100,
    runs: int = 1,
    seed: int = 0,
    schedule: Schedule | Settings = "constant",
    stop: Literal["never", "first-success"] = "never",
    tests: int = 0,
    dtype: Literal["float64", "float32"] = "float32",
) -> Training:
    """Train a learner in an environment, in several independent runs on all devices of JAX.

    Each run draws the same random numbers as the run of the same index of `bojax run` with the same seed.

    Args:
        env: The environment: a module, or settings, such as `"mountain-car"` or
            `{"kind": "gymnasium", "id": "MountainCar-v0"}`. An instance of a class of your own is a module.
        learner: The learner, as a module or settings.
        episodes: Number of training episodes of a run.
        runs: Number of runs.
        seed: Seed of all runs.
        schedule: Schedule of exploration over the episodes.
        stop: Whether a run ends at its first success.
        tests: Number of test episodes, without exploration or learning, after each training episode.
        dtype: Precision of parts built from settings; float64 requires `jax_enable_x64`.

    Raises:
        ValueError: A number is too small, or the learner does not support the spaces of the environment.
        ConfigError: The settings are invalid.
    """
    for name, number, least in (("episodes", episodes, 1), ("runs", runs, 1), ("tests", tests, 0)):
        if number < least:
            raise ValueError(f"{name}: got {number}; allowed: >= {least}")
    experiment = LearningRun(
        env=_part("env", env, dtype),
        learner=_part("learner", learner, dtype),
        schedule=_part("schedule", schedule, dtype),
        target_return=None,
        episodes=episodes,
        stop=stop,
        tests=tests,
        map_episodes=(),
        map_resolution=2,
        saved=None,
    )
    program = _compiled(experiment, runs, seed)
    chunks = [_run(program, experiment, first, runs) for first in range(0, runs, program.num_lanes)]
    summaries, rows, learned = zip(*chunks, strict=True)
    return Training(
        runs=pa.concat_tables(summaries),
        episodes=sort_rows(pa.concat_tables(rows)),
        experiment=experiment,
        learned=jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *learned),
    )


def _part(role: str, part: Any, dtype: Literal["float64", "float32"]) -> Any:
    if isinstance(part, import_target(roles()[role].protocol)):
        return part
    slot: Any = Annotated[Component, Slot(role)]
    try:
        settings = pydantic.TypeAdapter(slot).validate_python(part)
    except pydantic.ValidationError as error:
        raise from_validation(error, lambda location: dotted((role, *location))) from error
    return build(settings, dtype)


def _compiled(experiment: LearningRun, runs: int, seed: int) -> Compiled:
    mesh = make_mesh(jax.devices())
    limit = experiment.lanes_on_cpu if jax.default_backend() == "cpu" else LANES_ON_ACCELERATOR
    lanes = choose_lanes(runs, mesh.size, limit, None)
    (group,) = static_groups([experiment])
    return (Hosted if experiment.is_hosted else Compiled)(group, mesh, lanes, seed, snapshots=False)


def _run(
    program: Compiled, experiment: LearningRun, first: int, runs: int
) -> tuple[pa.Table, pa.Table, LearnerState]:
    """Run one batch: as many runs as there are lanes, starting with the run of index `first`."""
    numbers = np.arange(first, min(first + program.num_lanes, runs))
    num_lanes, every = len(numbers), np.arange(program.num_lanes)
    lanes = program.place(np.zeros_like(every), np.resize(numbers, len(every)), every < num_lanes)
    carry, records, is_done = program.init(lanes), [], False
    while not is_done:
        carry, tables, status = program.advance(carry, lanes)
        records.append({"episodes": tables["episodes"]})
        is_done = not np.asarray(status.remaining).any()
    points = np.zeros_like(numbers)
    keys = {"point": points, "run": numbers}
    summary = {name: np.asarray(values)[:num_lanes] for name, values in program.summary(carry, lanes).items()}
    rows = fetch_rows(records, experiment.tables, points, numbers, {})["episodes"]
    learned = jax.tree.map(lambda leaf: leaf[:num_lanes], program.exported_state(carry, lanes))
    return (
        to_arrow(KEYS + experiment.tables["runs"], keys | summary).drop_columns("point"),
        to_arrow(KEYS + experiment.tables["episodes"], rows).drop_columns("point"),
        learned,
    )
