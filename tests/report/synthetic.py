"""A results folder made up for the tests: the layout of a real one, shares known beforehand."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

import bojax
from bojax.experiments.settings import Learning, Planning
from bojax.report.columns import Columns
from bojax.report.manifest import ClaimEntry, Manifest
from bojax.report.source import Point, Results
from bojax.results.outline import Outline

MAX_STEPS = 15
SAMPLES = 12

# Of every 20 runs: how many park, how many leave the domain, and the step at which either happens.
BEHAVIOUR = {
    "kcbts": {"label": "kcbts", "parks": 16, "exits": 1, "at": 5},
    "sbo-5": {"label": "sbo", "parks": 5, "exits": 2, "at": 8},
    "sbo-9": {"label": "sbo", "parks": 9, "exits": 2, "at": 8},
    "gps-abt": {"label": "gps-abt", "parks": 3, "exits": 4, "at": 9},
    "random": {"label": "random", "parks": 0, "exits": 15, "at": 6},
}

CLAIMS = yaml.safe_load("""
- {id: order-holds, source: "Fig. 4.6, p. 99-100", thesis: kcbts > sbo > gps-abt > random,
   claim: "final accumulated reward: kCBTS > SBO > GPS-ABT > random",
   test: {kind: order, column: return, by: label, greater: [kcbts, sbo, gps-abt, random]}}
- {id: order-fails, source: p. 100, claim: random is above kCBTS, thesis: random > kcbts,
   test: {kind: order, column: return, by: label, greater: [random, kcbts]}}
- {id: share-holds, source: p. 100, claim: kCBTS parks in most episodes by step 6, thesis: most,
   test: {kind: share, column: success, label: kcbts, within: 6, above: 0.5}}
- {id: share-fails, source: p. 100, claim: SBO parks in most episodes by step 6, thesis: most,
   test: {kind: share, column: success, label: sbo, within: 6, above: 0.5}}
- {id: share-open, source: p. 100, claim: "SBO <parks> in fewer than 45% of runs & more", thesis: 0.45,
   test: {kind: share, column: success, label: sbo, below: 0.45}}
- {id: trend-holds, source: p. 100, claim: the curve of kCBTS falls after step 6, thesis: steady decrease,
   test: {kind: trend, label: kcbts, column: accumulated_reward, from: 6, to: 15, direction: falls}}
- {id: missing, source: p. 90, claim: CBTS is above random, thesis: cbts > random,
   test: {kind: order, column: return, by: label, greater: [cbts, random]}}
""")


def write_folder(
    folder: Path, tables: dict[str, list[dict]], points: list[dict], arrays: dict[str, dict], **manifest
) -> Path:
    """A results folder of these rows and snapshots, by name, whose manifest has these keys."""
    (folder / "arrays").mkdir(parents=True)
    for name, rows in tables.items():
        pq.write_table(pa.Table.from_pylist(rows), folder / f"{name}.parquet")
    for name, content in arrays.items():
        np.savez(folder / "arrays" / f"{name}-end.npz", **content)
    manifest = {"name": "made-up", "status": "finished", "points": points, **manifest}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def write_results(folder: Path, *, runs: int = 40, recorded: int = 8, report: dict | None = None) -> Path:
    """Write the folder; every number follows from `BEHAVIOUR` and a fixed seed."""
    random = np.random.default_rng(7)
    run_rows, step_rows, points, arrays = [], [], [], {}
    places = random.uniform(-3.5, 3.5, (2, runs))
    starts = np.stack([*places, random.uniform(0, 2 * np.pi, runs)], axis=1)
    for index, (variant, behaviour) in enumerate(BEHAVIOUR.items()):
        label = behaviour["label"]
        problem = {"kind": "parking", "half_width": 4.0, "distance_tolerance": 0.1, "max_steps": 15}
        planner = {"kind": label} if label == "random" else {"kind": label, "iterations": 300}
        points.append({"index": index, "label": label, "variant": variant, "swept": {"planner": variant}})
        points[-1]["config"] = {"kind": "planning", "problem": problem, "planner": planner}
        for run in range(runs):
            parks, exits = _outcome(behaviour, run)
            length = max(1, behaviour["at"] + run % 3 - 1) if parks or exits else MAX_STEPS
            rewards = -2.0 - 0.05 * run - random.uniform(0, 2, length) * (1 + index)
            rewards[-1] += 1000.0 * parks - 1000.0 * exits
            total = np.cumsum(rewards)
            run_rows.append((index, label, variant, variant, run, 0, total[-1], parks, length, int(exits), 0))
            for step in range(length):
                step_rows.append(
                    (index, label, run, step + 1, rewards[step], total[step], step == length - 1)
                )
            if run < recorded:
                paths = np.full((MAX_STEPS, SAMPLES, 3), np.nan)
                paths[:length] = _drive(starts[run], length, parks, exits, random)
                arrays[f"{index}-{run}-paths"] = {"paths": paths, "start": starts[run]}
    of_runs = "point label variant planner run seed return success steps exits nans"
    of_steps = "point label run step reward accumulated_reward done"
    tables = {"runs": _named(of_runs.split(), run_rows), "steps": _named(of_steps.split(), step_rows)}
    group = {"lanes_per_device": 200, "compile_seconds": 7.25, "active_steps": 12_345}
    manifest = {
        "name": "parking",
        "title": "Robot parking (Fig. 4.6)",
        "written": "2026-01-02T10:01:35+0000",
        "command": "bojax sweep sweeps/parking.yaml --runs 40",
        "runs": runs,
        "seed": 0,
        "config_hash": "0123abcd",
        "report": {"notes": "Left open: <what> & why."} if report is None else report,
        "claims": CLAIMS,
        "versions": {"python": "3.11.2", "bojax": bojax.__version__, "jax": "0.10.2", "numpy": "2.4.6"},
        "git": {"revision": "97d835b", "has_changes": True},
        "device": {"platform": "cpu", "kind": "cpu", "count": 2, "driver": None},
        "precision": {"x64": True, "dtypes": ["float64"] * len(points)},
        "groups": [group | {"points": [index], "run_seconds": 1.5 + index} for index in range(len(points))],
        "chunks": [{"error": None}],
    }
    write_folder(folder, tables, points, arrays, **manifest)
    latency = {
        "config_hash": manifest["config_hash"],
        "device": {"kind": "cpu"},
        "written": "2026-11-25T12:00:00+0000",
        "seconds": {str(index): [0.0123 * (1 + index)] * 3 for index in range(len(points))},
    }
    (folder / "latency.json").write_text(json.dumps(latency))
    return folder


SPACE = {
    "kind": "space-modelling",
    "domain": [0.0, 0.0, 6.0, 6.0],
    "walls": [[2.85, 0.0, 3.15, 2.6], [2.85, 3.4, 3.15, 6.0]],
    "start": [1.0, 1.0, 1.57],
    "target_area": [3.15, 0.0, 6.0, 6.0],
}
MONITORS = {"kcbts": ("kcbts", 0.1), "sbo-5": ("sbo", 0.2), "sbo-9": ("sbo", 0.15)}
"""Variants of a monitoring sweep: label and mean error."""


def write_monitoring(
    folder: Path, *, runs: int = 30, recorded: int = 2, report: dict | None = None, **problem
) -> Path:
    """A robot that learns two bumps: 25 steps of 8 samples; SBO is stopped in step 3."""
    random = np.random.default_rng(5)
    shared = random.normal(size=runs)
    run_rows, step_rows, points, arrays = [], [], [], {}
    for index, (variant, (label, error)) in enumerate(MONITORS.items()):
        config = {"kind": "planning", "problem": {**SPACE, **problem}, "planner": {"kind": label}}
        points.append({"index": index, "label": label, "variant": variant, "config": config})
        points[-1]["swept"] = {"planner": variant}
        for run in range(runs):
            rmse = error * (1 + 0.1 * shared[run] + 0.02 * random.normal())
            total = np.cumsum(random.uniform(10, 20, 25) / error)
            scores = (rmse, 0.8 * rmse, np.log(rmse), label == "sbo", 0)
            run_rows.append(
                (index, label, variant, variant, run, 0, total[-1], label == "kcbts", 25, 0, *scores)
            )
            step_rows += [(index, label, run, step + 1, total[step]) for step in range(25)]
            if run < recorded:
                paths, start = _wander(label == "sbo"), np.asarray(SPACE["start"])
                arrays[f"{index}-{run}-paths"] = {"paths": paths, "start": start}
                arrays[f"{index}-{run}-belief"] = _belief(paths, error)
    scores = ["rmse", "wrmse", "mnll", "collisions", "nans"]
    known = ["point", "label", "variant", "planner", "run", "seed", "return", "success", "steps", "exits"]
    tables = {
        "runs": _named(known + scores, run_rows),
        "steps": _named(["point", "label", "run", "step", "accumulated_reward"], step_rows),
    }
    manifest = {"name": "space", "runs": runs, "seed": 0, "report": report or {}, "claims": []}
    return write_folder(folder, tables, points, arrays, **manifest)


def _wander(is_stopped: bool) -> np.ndarray:
    t = np.linspace(0, 1, 201)[1:]
    x, y = 1 + 4 * t, 3 - 2 * np.cos(2 * np.pi * t)
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    poses = np.stack([x, y, heading], axis=1).reshape(25, 8, 3)
    if is_stopped:
        poses[2, 5:] = poses[2, 4]
    return poses


def _belief(paths: np.ndarray, error: float) -> dict[str, np.ndarray]:
    x = y = np.linspace(0, 6, 31)
    bumps = [(x[None] - cx) ** 2 + (y[:, None] - cy) ** 2 for cx, cy in ((1.2, 4.5), (4.8, 1.5))]
    truth = np.exp(-0.5 * np.stack(bumps)).sum(axis=0)
    far = np.min(np.hypot(x[None, :, None] - paths[:, -1, 0], y[:, None, None] - paths[:, -1, 1]), axis=-1)
    std = 1 - np.exp(-far)
    samples = np.full((200, 3), np.nan)
    samples[:190, :2] = paths.reshape(-1, 3)[:190, :2]
    return {
        "x": x,
        "y": y,
        "truth": truth,
        "mean": truth + 3 * error * std - error,
        "std": std,
        "samples": samples,
    }


LEARNERS = {"emu-q": 3, "rff-q": 12, "epsilon-greedy": None}
"""The episode in which a learner reaches the goal first, in a run of even index; None for never."""


def write_learning(
    folder: Path,
    *,
    runs: int = 30,
    episodes: int = 20,
    tests: int = 2,
    recorded: int = 2,
    lengths: tuple[int, ...] = (),
    report: dict | None = None,
    claims: list[dict] | None = None,
) -> Path:
    """Learners that reach the goal from some episode on: one later in runs of odd index, RFF-Q not in run 1.

    Their return is then 1, else -1; with `lengths`, steps to the goal are the episode times the length.
    """
    run_rows, episode_rows, step_rows, points, arrays = [], [], [], [], {}
    for learner, first in LEARNERS.items():
        for length in lengths or (0,):
            index = len(points)
            swept = {"learner": learner} | ({"env.length": length} if length else {})
            config = {"kind": "learning", "env": {"kind": "mountain-car"}, "learner": {"kind": learner}}
            config["episodes"] = episodes
            points.append(
                {"index": index, "label": learner, "variant": learner, "swept": swept, "config": config}
            )
            for run in range(runs):
                when = None if first is None or (run, learner) == (1, "rff-q") else first + run % 2
                at = when and when * (length or 10)
                reached = when if learner == "emu-q" else None
                after = None if reached is None else 0.5
                scores = (1.0 if when else -1.0, when is not None, episodes, 10 * episodes, when, at)
                row = (index, learner, learner, *swept.values(), run, 0, *scores, reached is not None)
                run_rows.append((*row, reached, after, 0))
                for episode in range(1, episodes + 1):
                    is_there = when is not None and episode >= when
                    value = 1.0 if is_there else -1.0
                    row = (value, 100 - episode, is_there, is_there, not is_there, 0.1)
                    episode_rows.append((index, learner, run, episode, "train", *row))
                    episode_rows += [(index, learner, run, episode, "test", *row)] * tests
                    if run < recorded and episode <= 3:
                        step_rows += _swing(index, learner, run, episode, is_there)
                if run < recorded:
                    arrays[f"{index}-{run}-values"] = _value_maps()
    keys = ["learner"] + (["env.length"] if lengths else [])
    scores = ["last_return", "success", "episodes", "steps", "episodes_to_goal", "steps_to_goal"]
    target = ["reached", "episodes_to_target", "return_after_target", "nans"]
    of_runs = ["point", "label", "variant", *keys, "run", "seed", *scores, *target]
    of_episodes = "point label run episode phase return length success terminated truncated kappa"
    of_steps = "point label run episode step reward accumulated_reward observation_0 observation_1"
    tables = {
        "runs": _named(of_runs, run_rows),
        "episodes": _named(of_episodes.split(), episode_rows),
        "steps": _named(of_steps.split(), step_rows),
    }
    group = {"group": 0, "points": [0], "run_seconds": 2.0, "active_steps": 5000}
    manifest = {"name": "car", "runs": runs, "seed": 0, "report": report or {}, "claims": claims or []}
    return write_folder(folder, tables, points, arrays, **manifest, groups=[group])


def _swing(index: int, learner: str, run: int, episode: int, is_there: bool) -> list[tuple]:
    angle = np.linspace(0, 4 * np.pi, 60)
    x, v = -0.5 + 0.3 * episode * np.sin(angle) * angle / 13, 0.02 * episode * np.cos(angle) * angle / 13
    rewards = np.where(np.arange(60) < 59, 0.0, float(is_there))
    rows = zip(rewards, np.cumsum(rewards), x, v, strict=True)
    return [(index, learner, run, episode, step + 1, *row) for step, row in enumerate(rows)]


def _value_maps() -> dict[str, np.ndarray]:
    axis = (np.arange(12) + 0.5) / 12
    far = np.hypot(axis[:, None] - 0.4, axis[None, :] - 0.5)
    maps = np.stack([np.stack([0 * far, far / episode - episode]) for episode in (1, 2, 3)])
    bounds = {"low": np.array([-1.2, -0.07]), "high": np.array([0.6, 0.07])}
    return {"maps": maps, "episodes": np.array([1, 2, 3]), **bounds}


def in_memory(
    runs: dict[str, dict[str, np.ndarray]],
    steps: dict[str, np.ndarray] | None = None,
    problem: dict | None = None,
    claims: list[dict] | None = None,
    episodes: dict[str, np.ndarray] | None = None,
    tests: dict[str, np.ndarray] | None = None,
    swept: dict[str, dict] | None = None,
    stop: str = "never",
) -> Results:
    """Results of made-up columns.

    Args:
        runs: By name, columns of runs.
        steps: By name, `[runs, steps]` of the column `value`.
        problem: Settings of the problem of every point.
        claims: Claims of the sweep.
        episodes: By name, `[runs, episodes]` of the column `value` in training; NaN where there is no row.
        tests: By name, `[runs, episodes, tests]` of it in the tests after each episode.
        swept: By name, label and swept numbers of the point.
        stop: Whether a run of a learner ends early.
    """
    names = list(runs)
    keys = {name: dict((swept or {}).get(name, {})) for name in names}
    labels = {name: keys[name].pop("label", name) for name in names}
    if episodes is None:
        experiment = Planning.model_validate({"problem": problem or "parking"})
    else:
        experiment = Learning.model_validate({"env": "mountain-car", "learner": "emu-q", "stop": stop})
    config = experiment.model_dump(mode="json")
    points = tuple(
        Point(i, labels[name], name, name, keys[name], config, experiment, Outline())
        for i, name in enumerate(names)
    )
    told = {"id": "x", "claim": "c", "source": "s"}
    manifest = manifest_of(claims=[ClaimEntry.model_validate({**told, **claim}) for claim in claims or []])
    results = Results(Path("nowhere"), manifest, points)
    sizes = [len(next(iter(columns.values()))) for columns in runs.values()]
    table = {
        "point": np.repeat(np.arange(len(names)), sizes),
        "run": np.concatenate([np.arange(size) for size in sizes]),
    }
    columns = next(iter(runs.values()))
    table |= {column: np.concatenate([runs[name][column] for name in names]) for column in columns}
    results.__dict__["runs"] = Columns(table)
    results.__dict__["steps"] = Columns({} if steps is None else _long(steps, names))
    results.__dict__["episodes"] = Columns()
    if episodes is not None:
        phases = [_episode_rows(episodes, names, "train")]
        if tests is not None:
            phases += [
                _episode_rows({name: values[..., test] for name, values in tests.items()}, names, "test")
                for test in range(tests[names[0]].shape[-1])
            ]
        results.__dict__["episodes"] = Columns(
            {key: np.concatenate([phase[key] for phase in phases]) for key in phases[0]}
        )
    return results


def manifest_of(**keys) -> Manifest:
    """A manifest of which only these keys are set."""
    return Manifest.model_construct(**keys)


def point_of(index: int, label: str, variant: str, swept: dict | None = None) -> Point:
    """A point of which only these attributes matter."""
    experiment = Planning.model_validate({})
    return Point(index, label, variant, variant, swept or {}, {}, experiment, Outline())


def _episode_rows(values: dict[str, np.ndarray], names: list[str], phase: str) -> dict[str, np.ndarray]:
    rows = _long(values, names)
    rows["episode"] = rows.pop("step")
    rows["phase"] = np.full(rows["run"].shape, phase, dtype=object)
    return {key: column[np.isfinite(rows["value"])] for key, column in rows.items()}


def _long(steps: dict[str, np.ndarray], names: list[str]) -> dict[str, np.ndarray]:
    num_runs, num_steps = steps[names[0]].shape
    run, step = np.indices((num_runs, num_steps))
    return {
        "point": np.repeat(np.arange(len(names)), num_runs * num_steps),
        "run": np.tile(run.ravel(), len(names)),
        "step": np.tile(step.ravel() + 1, len(names)),
        "value": np.concatenate([steps[name].ravel() for name in names]),
    }


def set_column(folder: Path, name: str, values) -> None:
    """Replace a column of `runs.parquet`, or append it; one value is that of all rows."""
    path = folder / "runs.parquet"
    rows = pq.read_table(path)
    column = pa.array(np.broadcast_to(values, rows.num_rows))
    is_new = name not in rows.column_names
    place = rows.num_columns if is_new else rows.column_names.index(name)
    pq.write_table((rows.add_column if is_new else rows.set_column)(place, name, column), path)


def edit_manifest(folder: Path, edit) -> None:
    """Change the manifest in place."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    edit(manifest)
    path.write_text(json.dumps(manifest))


def _outcome(behaviour: dict, run: int) -> tuple[bool, bool]:
    slot = (run * 7) % 20
    return slot < behaviour["parks"], slot >= 20 - behaviour["exits"]


def _drive(start, length, parks, exits, random) -> np.ndarray:
    """Steps of smooth poses that end at the goal, outside, or anywhere."""
    end = np.zeros(2) if parks else np.array([4.3, start[1]]) if exits else random.uniform(-3, 3, 2)
    t = np.linspace(0, 1, length * SAMPLES + 1)
    out = start[:2] + 2.0 * np.array([np.cos(start[2]), np.sin(start[2])])
    back = end - np.array([1.5, 0.0])
    basis = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    xy = basis.T @ np.stack([start[:2], out, back, end])
    heading = np.arctan2(np.gradient(xy[:, 1]), np.gradient(xy[:, 0]))
    poses = np.concatenate([xy, heading[:, None]], axis=1)[1:]
    return poses.reshape(length, SAMPLES, 3)


def _named(names: list[str], rows: list[tuple]) -> list[dict]:
    return [dict(zip(names, row, strict=True)) for row in rows]
