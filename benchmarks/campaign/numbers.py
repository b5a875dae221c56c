"""Extreme but valid numbers: a sweep refuses them in one line, or finishes with its NaN counted."""

import copy
import itertools
import random
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import cli, run, scratch
from benchmarks.campaign.trees import assign, at, paths

_PLANNING = ("--runs", "3", "planner.iterations=4", "problem.max_steps=3")
_LEARNING = ("--runs", "3", "episodes=3", "env.max_steps=15")
_FEATURES = ("learner.features.num_features=10",)

_BASES = (
    ("parking", *_PLANNING),
    ("parking", "planner=gps-abt", *_PLANNING),
    ("two-pits", "problem.resolution=5", *_PLANNING),
    ("two-pits", "planner=kcbts", "problem.resolution=5", "problem.relearn_every=2", *_PLANNING),
    ("chain", *_LEARNING),
    ("cliff-walking", "learner=additive", *_LEARNING),
    ("mountain-car", *_LEARNING, *_FEATURES),
    ("single-pendulum", "learner=rff-q", *_LEARNING, *_FEATURES),
)
"""Experiments that take seconds, as arguments of `bojax run`."""

_EXTREMES = (0.0, 5e-324, 1e-300, 1e-30, 1e-12, 1e-6, 0.999999, 1.0, 1e6, 1e12, 1e30, 1e150, 1e300, 1.79e308)

_MAX_TRIES = 20
_MODULE = "benchmarks.campaign.bad_parts"


def check(seed: int) -> Outcome:
    """Run a small experiment with settings that follow from the seed."""
    draw = random.Random(f"numbers {seed}")
    words = _bad_parts(draw) if draw.random() < 0.25 else _extremes(draw)
    with scratch() as place:
        ended = run(lambda: cli("run", *words, "--out", "out"), place, seconds=240)
        tried = " ".join(words)
        if fault := fault_of(ended, (0, 2)):
            return Outcome(tried, fault)
        return Outcome(tried, _miscounted(place / "out", ended.err) if ended.code == 0 else "")


def _extremes(draw: random.Random) -> tuple[str, ...]:
    """An experiment with one to three numbers of its settings at an extreme that its schema allows."""
    from bojax.config.errors import ConfigError
    from bojax.config.sweep import load_config

    name, *options = draw.choice(_BASES)
    overrides = [word for word in options if "=" in word]
    tree = load_config(name, overrides).points[0].config.model_dump(mode="json")
    numbers = [path for path in paths(tree) if isinstance(at(tree, path), float)]
    changed: dict[tuple, str] = {}
    for _ in range(draw.randint(1, 3)):
        for _ in range(_MAX_TRIES):
            path, value = draw.choice(numbers), draw.choice(_EXTREMES) * draw.choice([1, 1, 1, -1])
            # An entry of a list is no setting of its own.
            setting = tuple(itertools.takewhile(lambda part: isinstance(part, str), path))
            if setting in changed:
                continue
            trial = copy.deepcopy(tree)
            assign(trial, path, value)
            text = f"{'.'.join(setting)}={at(trial, setting)}"
            try:
                load_config(name, [*overrides, *changed.values(), text], 3)
            except ConfigError:
                continue
            changed[setting] = text
            break
    return (name, *options, *changed.values())


def _bad_parts(draw: random.Random) -> tuple[str, ...]:
    """A user's problem or environment that gives wrong numbers."""
    wrong = draw.choice(["nan", "inf", "minus-inf", "huge", "tiny"])
    settings = f"share: {draw.choice([0.05, 0.5, 1.0])}, wrong: {wrong}"
    if draw.random() < 0.5:
        settings += ", max_steps: 3, position_noise: 0.0, heading_noise: 0.0"
        planner = draw.choice(["kcbts", "random", "sbo", "gps-abt"])
        words = ("parking", f"problem={{kind: '{_MODULE}:Meadow', {settings}}}", f"planner={planner}")
        return (*words, "--runs", "3", *(() if planner == "random" else ("planner.iterations=4",)))
    settings += f", max_steps: 15, where: {draw.choice(['reward', 'observation'])}"
    learner = draw.choice(["emu-q", "rff-q"])
    words = ("mountain-car", f"env={{kind: '{_MODULE}:Rail', {settings}}}", f"learner={learner}")
    return (*words, "--runs", "3", "episodes=3", *_FEATURES)


def _miscounted(folder: Path, err: str) -> str:
    """Whether the NaN in the tables are all counted, and told; empty if they are."""
    found = 0
    for path in (folder / f"{name}.parquet" for name in ("runs", "steps", "episodes")):
        for column in pq.read_table(path).columns if path.exists() else ():
            if pa.types.is_floating(column.type):
                found += int(np.isnan(column.to_numpy()).sum())
    counted = sum(pq.read_table(folder / "runs.parquet")["nans"].to_pylist())
    if found != counted:
        return f"{found} NaN in the tables, {counted} counted"
    if found and "warning: " not in err:
        return f"{found} NaN, and no warning"
    return "" if (folder / "report.html").exists() else "no report"
