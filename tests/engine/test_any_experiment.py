"""Experiments drawn from the schemas run to their end, and their tables are as docs/results.md says."""

import random
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
import yaml

from bojax.cli.main import main
from bojax.config.errors import ConfigError
from bojax.config.extras import MissingExtra
from bojax.config.sweep import load_config
from bojax.results.store import read_table
from tests.drawn import drawn_experiment
from tests.parts import FILES
from tests.tiers import by_tier

NUMBER = 40

LARGEST = 10**7
"""Numbers in the state of a run: 4^7 Fourier features have matrices of 2.7 * 10^8."""

KEYS = {
    "runs": ["point", "run"],
    "steps": ["point", "run", "episode", "step"],
    "episodes": ["point", "run", "episode"],
}
"""The columns by which a table is sorted, as far as it has them; tests of an episode follow its training."""


def write_drawn(seed: int, folder: Path) -> Path:
    """A config whose parts fit each other, and the data files that it names."""
    from bojax.engine.build import build

    for name, text in FILES.items():
        (folder / name).write_text(text)
    draw, path = random.Random(seed), folder / "drawn.yaml"
    while True:
        settings = drawn_experiment(draw).model_dump(mode="json")
        path.write_text(yaml.safe_dump({"experiment": settings.pop("kind"), **settings}))
        try:
            config = load_config(str(path)).points[0].config
            experiment = build(config, getattr(config, "dtype", "float64"))
        except (ConfigError, MissingExtra):
            continue
        if experiment.is_hosted:
            return path
        state = jax.eval_shape(experiment.init, jax.random.key(0))
        if sum(leaf.size for leaf in jax.tree.leaves(state)) < LARGEST:
            return path


@pytest.mark.parametrize("seed", by_tier(range(NUMBER), normal=(2,)))
def test_a_drawn_experiment(usual_jax, here, capfd, seed):
    path = write_drawn(seed, here)
    code = main(["run", str(path), "--runs", "2", "--out", "out"])
    error = capfd.readouterr().err
    assert code == 0, f"{error}\n{path.read_text()}"
    assert not faults(here / "out"), path.read_text()


def faults(folder: Path) -> list[str]:
    """What is wrong with the tables of results."""
    paths = {name: folder / f"{name}.parquet" for name in KEYS}
    tables = {name: read_table(path) for name, path in paths.items() if path.exists()}
    found = [f"{name}: {fault}" for name, table in tables.items() for fault in _of_table(name, table)]
    runs = tables["runs"]
    nans = sum(_count(table, pc.is_nan) for name, table in tables.items())
    if nans != pc.sum(runs["nans"]).as_py():
        found.append(f"{nans} NaN in the tables, {runs['nans'].to_pylist()} counted")
    steps, episodes = tables.get("steps"), tables.get("episodes")
    for run in runs.to_pylist():
        if run["nans"]:
            continue
        if steps is not None and episodes is None:
            found += _of_planning(run, _rows(steps, run))
        if episodes is not None:
            found += _of_learning(run, _rows(episodes, run), None if steps is None else _rows(steps, run))
    if not (folder / "report.html").exists():
        found.append("no report")
    return found


def _count(table: pa.Table, test) -> int:
    columns = [column for column in table.columns if pa.types.is_floating(column.type)]
    return sum(pc.sum(test(column)).as_py() or 0 for column in columns)


def _of_table(name: str, table: pa.Table) -> list[str]:
    keys = [key for key in KEYS[name] if key in table.column_names]
    found = []
    if _count(table, pc.is_inf):
        infinite = [c for c in table.column_names if _count(table.select([c]), pc.is_inf)]
        found.append(f"infinite values in {infinite}")
    rows = list(zip(*(table[key].to_pylist() for key in keys), strict=True))
    if rows != sorted(rows):
        found.append(f"not sorted by {keys}")
    return found


def _rows(table: pa.Table, run: Mapping) -> dict[str, np.ndarray]:
    mask = pc.and_(pc.equal(table["point"], run["point"]), pc.equal(table["run"], run["run"]))
    found = table.filter(mask)
    return {name: found[name].to_numpy() for name in found.column_names}


def _of_planning(run: Mapping, steps: Mapping[str, np.ndarray]) -> list[str]:
    count = run["steps"]
    checks = {
        "one row a step": np.array_equal(steps["step"], np.arange(1, count + 1)),
        "done at the last step alone": np.array_equal(steps["done"], np.arange(1, count + 1) == count),
        "accumulated rewards": np.allclose(
            steps["accumulated_reward"], np.cumsum(steps["reward"]), rtol=1e-4
        ),
        "the return": np.isclose(run["return"], steps["reward"].sum(), rtol=1e-4, atol=1e-4),
    }
    if "heading" in steps:  # of a robot
        heading = steps["heading"]
        checks["headings in [0, 2 pi)"] = np.all((heading >= 0) & (heading < 2 * np.pi + 1e-6))
    return [f"run {run['run']}: {check}" for check, holds in checks.items() if not holds]


def _of_learning(run: Mapping, episodes: Mapping[str, np.ndarray], steps: Mapping | None) -> list[str]:
    train = episodes["phase"] == "train"
    lengths, successes = episodes["length"][train], episodes["success"][train]
    first = int(np.argmax(successes)) + 1 if successes.any() else None
    checks = {
        "one row a training episode": np.array_equal(
            episodes["episode"][train], np.arange(1, run["episodes"] + 1)
        ),
        "the number of steps": lengths.sum() == run["steps"],
        "success": bool(successes.any()) == run["success"],
        "episodes to the goal": run["episodes_to_goal"] == first,
        "the return of the last training episode": np.isclose(
            run["last_return"], episodes["return"][train][-1], rtol=1e-4
        ),
        "each episode has an end": np.all(episodes["length"] >= 1),
    }
    if steps is not None and len(steps["step"]):
        checks["the steps of training episodes"] = len(steps["step"]) == run["steps"]
    return [f"run {run['run']}: {check}" for check, holds in checks.items() if not holds]
