"""Saved learners: collected by the chunks, merged into one tree for each point, and loaded again."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from bojax.config.files import EXPERIMENT
from bojax.config.yaml_file import dump
from bojax.numerics import checkpoint
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import (
    LEARNERS,
    ResultsError,
    explained,
    fingerprints,
    make_folder,
    read_checked_json,
    remove,
    sync,
    write_checked_json,
    write_content,
)

LEARNED = "learner"
"""Folder of the learners of a point, next to the config that evaluates one of them."""

EVALUATION_EPISODES = 20
"""Number of episodes of an evaluation; `episodes=` overrides it."""

_ADVICE = "a saved learner loads only with the same kind of learner, features and spaces of the environment"


class Learned:
    """The exported states of the learners of some runs, on the host."""

    def __init__(self):
        self._states: dict[int, dict[int, dict[str, np.ndarray]]] = defaultdict(dict)

    def __bool__(self) -> bool:
        return bool(self._states)

    def add(self, point: int, run: int, state: PyTree) -> None:
        """Add the state of a run, which is copied to the host."""
        self._states[point][run] = jax.device_get(checkpoint.arrays(state))

    def add_stacked(self, content: Mapping[str, Any]) -> None:
        """Add what `stacked` has returned."""
        for point, found in content.items():
            for index, run in enumerate(found["run"].tolist()):
                self._states[int(point)][run] = {
                    name: values[index] for name, values in found["state"].items()
                }

    def stacked(self) -> dict[str, Any]:
        """For each point, its runs in order, and their arrays with the runs along the first axis."""
        content = {}
        for point, states in sorted(self._states.items()):
            runs = sorted(states)
            content[str(point)] = {
                "run": np.asarray(runs),
                "state": {name: np.stack([states[run][name] for run in runs]) for name in states[runs[0]]},
            }
        return content


def merge_learners(folder: Path, chunks: Iterable[ChunkFolder], configs: Sequence[Mapping[str, Any]]) -> None:
    """Write the learners of chunks that are done to `learners/<point>`, replacing those of an earlier merge.

    `configs` has the resolved config of each point.

    Raises:
        ResultsError: A file of a chunk is missing or has changed, or the folder cannot be written.
    """
    learned = Learned()
    for path in [path for chunk in chunks for path in chunk.learners()]:
        learned.add_stacked(checkpoint.read(path))
    for point, content in learned.stacked().items():
        target = folder / LEARNERS / point
        with explained(target):
            remove(target)
        write_learners(target, content)
        write_content(target / EXPERIMENT, dump(evaluation(configs[int(point)])))


def write_learners(folder: Path, content: Mapping[str, Any]) -> None:
    """Write the learners of a point, as `Learned.stacked` has them, with the checksums of their files.

    Raises:
        ResultsError: The folder cannot be written.
    """
    make_folder(folder)
    tree = folder / LEARNED
    checkpoint.save(tree, content)()
    with explained(tree):
        sync(tree, *tree.rglob("*"))
    write_checked_json(_checksums(tree), fingerprints(tree))  # last: without it, a cut-off tree is refused


def load_learner(folder: Path, run: int, structure: PyTree[jax.ShapeDtypeStruct]) -> PyTree:
    """The state of the learner of a run.

    Raises:
        ResultsError: No learner is saved, a file has changed, or the structure is another one.
    """
    if not folder.is_dir():
        raise ResultsError(
            f"{folder}: no such folder; allowed: the folder {LEARNED} of a point in {LEARNERS}/"
        )
    if fingerprints(folder) != read_checked_json(_checksums(folder)):
        raise ResultsError(f"{folder}: damaged or edited: its files are not those in {_checksums(folder)}")
    content = checkpoint.read(folder)
    runs = content["run"].tolist()
    if run not in runs:
        raise ResultsError(f"{folder}: holds no learner of run {run}; allowed: {', '.join(map(str, runs))}")
    arrays = {name: values[runs.index(run)] for name, values in content["state"].items()}
    return checkpoint.fit(arrays, structure, folder, _ADVICE)


def evaluation(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config that evaluates a learner saved by an experiment of the given config."""
    kept = {name: value for name, value in config.items() if name not in ("kind", "target_return", "tests")}
    changed = {"schedule": "exploit", "episodes": EVALUATION_EPISODES, "stop": "never"}
    saved = {"saved": LEARNED, "saved_run": 0}
    return {"experiment": config["kind"], **kept, **saved, **changed, "map_episodes": []}


def _checksums(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.json")
