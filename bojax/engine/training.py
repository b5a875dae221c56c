"""Training from Python: runs of a learner in an environment, without files.

Sweeps, target returns, checkpoints and reports are features of the command line only.
"""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import jax
import jax.numpy as jnp
import pyarrow as pa
from rich.console import Console
from typing_extensions import override

from bojax.config.catalog import named
from bojax.config.component import Component
from bojax.engine.build import build
from bojax.engine.chunks import choose_layout, cut
from bojax.engine.devices import choose, find_devices, same_draws, suited, workers_of
from bojax.engine.execute import execute
from bojax.engine.groups import static_groups
from bojax.engine.policies import Policy, check_seed
from bojax.engine.progress import SweepProgress
from bojax.engine.runner import Limits
from bojax.engine.storage import Sink, Storage
from bojax.engine.tasks import GroupTask
from bojax.envs.base import Env
from bojax.experiments.learning import LearningRun
from bojax.learning.base import Learner, LearnerState
from bojax.learning.schedules import Schedule
from bojax.models.checks import check_count
from bojax.results.tables import sort_rows

Settings: TypeAlias = str | Mapping[str, Any] | Component
"""A built-in part as in a config file: its kind, its kind with settings, or its schema class."""


Callback: TypeAlias = Callable[[pa.Table], Any]
"""Receives rows of episodes, as in `Training.episodes`."""


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

    def policy(self, run: int = 0, seed: int = 0) -> Policy:
        """The policy that a run has learned, without exploration: a function of the observation.

        Args:
            run: Index of the run.
            seed: Seed of the random draws of the policy, which break ties or propose candidate actions.

        Raises:
            ValueError: There is no such run.
        """
        # JAX takes an index beyond the end for the last one.
        if check_count("run", run, 0) >= self.runs.num_rows:
            raise ValueError(f"run: got {run}; allowed: < {self.runs.num_rows}, the number of runs")
        return Policy(self.experiment, jax.tree.map(lambda leaf: leaf[run], self.learned), seed)


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
    callback: Callback | None = None,
) -> Training:
    """Train a learner in an environment, in several independent runs on all GPUs, or on the CPU.

    Each run draws the same random numbers as the run of the same index of `bojax run` with the same seed,
    whatever flags of JAX are set here.

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
        callback: Called after each episode with its rows and the rows of its tests, for all runs that are
            computed together; more runs than lanes are computed one batch after another. The calls come from
            other threads, one at a time. An exception in it ends the training, and is raised here.

    Raises:
        ValueError: A number is too small, or the learner does not support the spaces of the environment.
        ConfigError: The settings are invalid.
    """
    check_count("runs", runs, 1)
    check_seed(seed)
    if callback is not None and not callable(callback):
        raise ValueError(f"callback: got {callback!r:.60}; allowed: a function of a table")
    parts = {"env": env, "learner": learner, "schedule": schedule}
    settings = {"episodes": episodes, "stop": stop, "tests": tests, "dtype": dtype}
    with same_draws():
        experiment = build(named("experiment", {"kind": "learning", **parts, **settings}), dtype)
        if callback is not None:
            experiment = experiment.one_by_one()
        sinks = _run(experiment, runs, seed, callback)
    tables = {
        name: pa.concat_tables(part for sink in sinks for part in sink.tables[name]).drop_columns("point")
        for name in ("runs", "episodes")
    }
    learned = {run: state for sink in sinks for (_, run), state in sink.learned.items()}
    return Training(
        runs=sort_rows(tables["runs"]),
        episodes=sort_rows(tables["episodes"]),
        experiment=experiment,
        learned=jax.tree.map(lambda *leaves: jnp.stack(leaves), *(learned[run] for run in range(runs))),
    )


class _Sink(Sink):
    """Passes on the rows of each segment, which is one episode."""

    def __init__(self, saved_learners: int, callback: Callback, lock: threading.Lock):
        super().__init__(saved_learners=saved_learners)
        self._callback, self._lock = callback, lock

    @override
    def write_piece(self, tables: dict[str, pa.Table]) -> None:
        super().write_piece(tables)
        with self._lock:
            self._callback(sort_rows(tables["episodes"].drop_columns("point")))


def _run(experiment: LearningRun, runs: int, seed: int, callback: Callback | None) -> list[Sink]:
    """Run an experiment on the devices that suit it, and return what its chunks produced."""
    devices = suited(choose(find_devices("auto"), None))
    (group,) = static_groups([experiment])
    layout = choose_layout(experiment, runs, devices[0].platform, None)
    lock = threading.Lock()

    def sink() -> Sink:
        return Sink(saved_learners=runs) if callback is None else _Sink(runs, callback, lock)

    chunks = cut(group, range(runs), layout, [{}], {})
    storage = Storage(sink)
    task = GroupTask(
        group=group,
        experiment=experiment,
        name="train",
        seed=seed,
        layout=layout,
        platform=devices[0].platform,
        chunks=deque(chunks),
        limits=Limits(float("inf") if callback is None else 0.0, float("inf")),
        storage=storage,
    )
    quiet = SweepProgress("train", runs, console=Console(quiet=True))
    for _ in execute([task], workers_of(devices), quiet, lambda: bool(storage.errors)):
        pass
    if storage.errors:
        raise storage.errors[0]
    return [storage.sinks[chunk.index] for chunk in chunks]
