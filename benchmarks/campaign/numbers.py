"""Extreme but valid numbers: a sweep refuses them in one line, or finishes with its NaN counted."""

import copy
import functools
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import run, scratch

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


def check(seed: int) -> Outcome:
    """Run a small experiment with settings that follow from the seed."""
    draw = random.Random(f"numbers {seed}")
    words = _bad_parts(draw) if draw.random() < 0.25 else _extremes(draw)
    with scratch() as place:

        def start() -> int:
            from bojax.cli.main import main

            return main(["run", *words, "--out", "out"])

        ended = run(start, place, seconds=240)
        tried = " ".join(words)
        if fault := fault_of(ended, (0, 2)):
            return Outcome(tried, fault)
        return Outcome(tried, _miscounted(place / "out", ended.err) if ended.code == 0 else "")


def _extremes(draw: random.Random) -> tuple[str, ...]:
    """An experiment with one to three numbers of its settings at an extreme that its schema allows."""
    from bojax.config.errors import ConfigError
    from bojax.config.sweep import load_config

    base = draw.choice(_BASES)
    tree = _tree(base)
    paths = [path for path, value in _leaves(tree) if isinstance(value, float)]
    words: tuple[str, ...] = ()
    for _ in range(draw.randint(1, 3)):
        for _ in range(_MAX_TRIES):
            path, value = draw.choice(paths), draw.choice(_EXTREMES) * draw.choice([1, 1, 1, -1])
            key = _key(path)
            if any(word.partition("=")[0] == key for word in words):
                continue
            text = f"{key}={_with(tree, path, len(key.split('.')), value)}"
            try:
                load_config(base[0], [*(word for word in base[1:] if "=" in word), *words, text], 3)
            except ConfigError:
                continue
            words += (text,)
            break
    return (*base, *words)


def _bad_parts(draw: random.Random) -> tuple[str, ...]:
    """A user's problem or environment that gives wrong numbers."""
    wrong = draw.choice(["nan", "inf", "minus-inf", "huge", "tiny"])
    share = draw.choice([0.05, 0.5, 1.0])
    if draw.random() < 0.5:
        kind = (
            f"{{kind: 'benchmarks.campaign.bad_parts:Meadow', share: {share}, wrong: {wrong}, max_steps: 3, "
        )
        kind += "position_noise: 0.0, heading_noise: 0.0}"
        planner = draw.choice(["kcbts", "random", "sbo", "gps-abt"])
        return ("parking", f"problem={kind}", f"planner={planner}", "--runs", "3", *_iterations(planner))
    where = draw.choice(["reward", "observation"])
    kind = f"{{kind: 'benchmarks.campaign.bad_parts:Rail', share: {share}, wrong: {wrong}, where: {where}, "
    kind += "max_steps: 15}"
    learner = draw.choice(["emu-q", "rff-q"])
    return ("mountain-car", f"env={kind}", f"learner={learner}", "--runs", "3", "episodes=3", *_FEATURES)


def _iterations(planner: str) -> tuple[str, ...]:
    return () if planner == "random" else ("planner.iterations=4",)


@functools.cache
def _loaded(base: tuple[str, ...]) -> dict[str, Any]:
    from bojax.config.sweep import load_config

    return load_config(base[0], [word for word in base[1:] if "=" in word]).points[0].config.model_dump()


def _tree(base: tuple[str, ...]) -> dict[str, Any]:
    return copy.deepcopy(_loaded(base))


def _leaves(tree: Any, path: tuple = ()) -> Iterator[tuple[tuple, Any]]:
    entries = tree.items() if isinstance(tree, dict) else ()
    entries = enumerate(tree) if isinstance(tree, list | tuple) else entries
    for key, value in entries:
        yield (*path, key), value
        yield from _leaves(value, (*path, key))


def _key(path: tuple) -> str:
    """The dotted path of a setting; an entry of a list is no setting of its own."""
    names = []
    for part in path:
        if not isinstance(part, str):
            break
        names.append(part)
    return ".".join(names)


def _with(tree: Any, path: tuple, depth: int, value: float) -> Any:
    """The setting that holds the number at `path`, with that number replaced."""
    if len(path) == depth:
        return repr(value)
    for key in path[:depth]:
        tree = tree[key]

    def replaced(node: Any, rest: tuple) -> Any:
        if not rest:
            return value
        return [replaced(item, rest[1:]) if i == rest[0] else item for i, item in enumerate(node)]

    return str(_listed(replaced(tree, path[depth:])))


def _listed(node: Any) -> Any:
    return [_listed(item) for item in node] if isinstance(node, list | tuple) else node


def _miscounted(folder: Path, err: str) -> str:
    """Whether the NaN in the tables are all counted, and told; empty if they are."""
    found = 0
    for name in ("runs", "steps", "episodes"):
        if not (folder / f"{name}.parquet").exists():
            continue
        table = pq.read_table(folder / f"{name}.parquet")
        for column in table.columns:
            if pa.types.is_floating(column.type):
                found += pc.call_function("sum", [pc.call_function("is_nan", [column])]).as_py() or 0
    counted = sum(pq.read_table(folder / "runs.parquet")["nans"].to_pylist())
    if found != counted:
        return f"{found} NaN in the tables, {counted} counted"
    if found and "warning: " not in err:
        return f"{found} NaN, and no warning"
    return "" if (folder / "report.html").exists() else "no report"
