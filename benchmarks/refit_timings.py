"""The recording and the timings of bench_refit.py, run in a process with its own cores."""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from bench_refit import SETS, parse
from rich.console import Console
from rich.table import Table
from timing import Row, describe_device, median_seconds, on_gpu, print_rows, write_record

from bojax.engine.build import build
from bojax.envs.settings import CartpoleSwingUp, LunarLander
from bojax.experiments.settings import Learning
from bojax.learning.base import Episode, ExplorationState, Transition
from bojax.learning.settings import EMUQ, RandomFourierFeatures
from bojax.numerics.lanes import LANES

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from tests.reference.emu_q import DirectRefit  # noqa: E402

DOMAINS = {
    "lunar-lander": (LunarLander(), {"state_lengthscale": 0.5, "action_lengthscale": 0.3}),
    "cartpole-swing-up": (CartpoleSwingUp(), {"state_lengthscale": 0.8, "action_lengthscale": 1.0}),
}
"""Environments of Table 5.3 and the lengthscales of Table 5.2."""

ROWS = "observations", "actions", "rewards", "next_observations", "terminated"


def make_run(domain: str, num_features: int, refit: Literal["direct", "none"] = "direct"):
    """A run of Table 5.3; its episodes end with the first success."""
    env, lengthscales = DOMAINS[domain]
    features = RandomFourierFeatures(**lengthscales, num_features=num_features)
    learner = EMUQ(features=features, prior_precision=0.01, refit=refit)
    return build(Learning(env=env, learner=learner, episodes=100, stop="first-success"), "float32")


def empty_state(run, index):
    """The state of a learner that has observed nothing."""
    key = jax.random.fold_in(jax.random.key(0), index)
    return run.new_learner(key, run.episodes * run.env.max_steps)


# Recording.


def record(args, name: str) -> None:
    """Record the states of runs before a refit, and what NumPy makes of them."""
    domain, num_features, episode = SETS[name]
    run, online = make_run(domain, num_features), make_run(domain, num_features, "none")
    keys = jax.random.split(jax.random.key(args.seed), 4 * args.runs)
    carry = jax.jit(jax.vmap(run.init, axis_name=LANES))(keys)
    advance, online_advance = (jax.jit(jax.vmap(r.advance, axis_name=LANES)) for r in (run, online))
    for _ in range(episode - 1):
        carry = advance(carry)[0]
    # The means before the refit are those of an episode without one; the transitions are those of the
    # same episode with one.
    means = online_advance(carry)[0].learner.posterior.mean
    carry = advance(carry)[0]
    going = np.flatnonzero(np.asarray(carry.episodes_to_goal) < 0)[: args.runs]
    most = int(carry.learner.memory.count[going].max())
    states = eqx.tree_at(lambda s: s.posterior.mean, carry.learner, means)
    states = row_of(states, going)
    memory = jax.tree.map(lambda x: x[:, :most] if x.ndim > 1 else x, states.memory)
    saved: dict[str, Any] = {"count": np.asarray(memory.count), "mean": np.asarray(states.posterior.mean)}
    for part, tree in (("features", states.features), ("memory", memory)):
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
        saved |= {f"{part}{i}": leaf for i, leaf in enumerate(leaves)}
    args.states.mkdir(parents=True, exist_ok=True)
    path = args.states / f"{name}.npz"
    np.savez_compressed(path, **saved)
    states, keys = load(args, name, run)
    references = [reference(run, row_of(states, i), keys[i]) for i in range(len(going))]
    np.savez_compressed(path, **saved, reference=np.stack([r[0] for r in references]))
    policies = [r[1] for r in references]
    print(f"{name}: {len(going)} runs of {saved['count']} transitions, policies {policies}", flush=True)


def load(args, name: str, run):
    """The recorded states, with the covariance of their transitions in float64, and a key for each."""
    with np.load(args.states / f"{name}.npz") as file:
        saved = {key: file[key] for key in file.files}
    number = len(saved["count"])
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(args.seed), jnp.arange(number))
    # Leaves that all runs share, such as candidates drawn once, come from a new state.
    empty = jax.vmap(lambda index: empty_state(run, index))(jnp.arange(number))

    def filled(part: str, tree):
        leaves, structure = jax.tree.flatten(tree)
        given = [saved[f"{part}{i}"] for i in range(len(leaves))]
        padded = [
            np.pad(new, [(0, old - now) for old, now in zip(leaf.shape, new.shape, strict=True)])
            for leaf, new in zip(leaves, given, strict=True)
        ]
        return jax.tree.unflatten(structure, [jnp.asarray(x) for x in padded])

    features, memory = filled("features", empty.features), filled("memory", empty.memory)

    @jax.jit
    def covariance(features, memory):
        phi = jax.vmap(features)(memory.observations, memory.actions).astype(jnp.float64)
        is_valid = jnp.arange(len(phi)) < memory.count
        phi = jnp.where(is_valid[:, None], phi, 0.0)
        precision = run.learner.noise_precision * phi.T @ phi
        precision = precision + run.learner.prior_precision * jnp.eye(phi.shape[1])
        return jnp.linalg.inv(precision).astype(jnp.float32)

    most = int(saved["count"].max())
    stored = jax.tree.map(lambda x: x[:, :most] if x.ndim > 1 else x, memory)
    bases = [covariance(*row_of((features, stored), i)) for i in range(number)]
    where = lambda s: (s.features, s.memory, s.posterior.base, s.posterior.mean)  # noqa: E731
    states = eqx.tree_at(where, empty, (features, memory, jnp.stack(bases), jnp.asarray(saved["mean"])))
    return states, keys


def row_of(tree, index):
    """The parts of one run."""
    return jax.tree.map(lambda x: x[index], tree)


def reference(run, state, key) -> tuple[np.ndarray, int]:
    """The means after a refit in NumPy, in float64, and the number of policies."""
    learner, number = run.learner, int(state.memory.count)
    candidates, samples = learner.actions(jax.random.split(key)[1], state)
    features = jax.tree.map(
        lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, state.features
    )
    phi = jax.jit(jax.vmap(features))
    numpy_refit = DirectRefit(
        lambda states, actions: np.asarray(phi(jnp.asarray(states), jnp.asarray(actions))),
        features.num_features,
        lambda: np.asarray(candidates, np.float64),
        lambda: np.asarray(samples, np.float64),
        alpha=float(learner.prior_precision),
        tolerance=float(learner.tolerance),
        max_sweeps=learner.max_sweeps,
    )
    numpy_refit.m_q, numpy_refit.m_u = np.asarray(state.posterior.mean, np.float64).T
    rows = jax.tree.map(lambda x: np.asarray(x[:number]) if x.ndim else x, state.memory)
    rows = [getattr(rows, name) for name in ROWS]
    own = numpy_refit.phi(*rows[:2])
    numpy_refit.s = np.linalg.inv(numpy_refit.alpha * np.eye(own.shape[1]) + numpy_refit.beta * own.T @ own)
    numpy_refit.end_episode(*rows)
    return np.stack([numpy_refit.m_q, numpy_refit.m_u], axis=1), numpy_refit.policies


# Measurement.


def measure(args) -> tuple[list[Row], list[list[str]]]:
    """Compile all programs, then time each and compare its means with those of NumPy."""
    cases = [(name, number) for name in args.sets for number in args.lanes or default_lanes(name)]
    runs = {name: make_run(*SETS[name][:2]) for name in args.sets}
    loaded = {name: load(args, name, runs[name]) for name in args.sets}

    def arguments(name: str, number: int):
        states, keys = loaded[name]
        index = np.arange(number) % len(keys)
        return row_of((keys, states), index)

    def program(case):
        learner, shapes = runs[case[0]].learner, jax.eval_shape(lambda: arguments(*case))

        def refit(key, state):
            rows = Transition(*(getattr(state.memory, name)[:1] for name in ROWS))
            nothing = Episode(rows, jnp.zeros((), jnp.int32))
            exploring = ExplorationState(jnp.ones((), jnp.float32), jnp.asarray(True))
            return learner.end_episode(key, state, nothing, exploring).posterior.mean

        start = time.perf_counter()
        compiled = jax.jit(jax.vmap(refit, axis_name=LANES)).lower(*shapes).compile()
        return compiled, time.perf_counter() - start

    with ThreadPoolExecutor(8 if on_gpu() else 1) as pool:
        programs = list(pool.map(program, cases))
    rows, table = [], []
    for (name, number), (compiled, compile_seconds) in zip(cases, programs, strict=True):
        given = jax.block_until_ready(arguments(name, number))
        errors = errors_of(args, name, np.asarray(compiled(*given), np.float64))
        seconds = median_seconds(partial(compiled, *given), args.repeats)
        work = int(jnp.sum(given[1].memory.count))
        rows.append(Row(f"{name}, {number} at once", number, seconds, work, compile_seconds))
        times = f"{work / number:,.0f}", f"{1e3 * seconds:.1f}", f"{compile_seconds:.1f}"
        table.append([rows[-1].what, *times, *errors])
    return rows, table


def measure_episodes(args) -> list[Row]:
    """Time whole episodes, a refit after each, of runs that start at once."""
    rows = []
    for domain, number in dict.fromkeys(SETS[name][:2] for name in args.sets):
        run = make_run(domain, number)
        init, advance = (jax.jit(jax.vmap(f, axis_name=LANES)) for f in (run.init, run.advance))
        for lanes in args.lanes or [200 if on_gpu() else 1]:
            carry = init(jax.random.split(jax.random.key(args.seed), lanes))
            start = time.perf_counter()
            compiled = advance.lower(carry).compile()
            compile_seconds = time.perf_counter() - start

            def last(carry=carry, compiled=compiled):
                for _ in range(args.episodes):
                    carry = compiled(carry)[0]
                return carry.learner.posterior.mean

            means = np.asarray(last()).reshape(lanes, -1)
            assert len(np.unique(means, axis=0)) == lanes, "each run must learn something else"
            seconds, work = median_seconds(last, args.repeats), lanes * args.episodes
            rows.append(Row(f"{domain}, {args.episodes} episodes", lanes, seconds, work, compile_seconds))
    return rows


def default_lanes(name: str) -> list[int]:
    """Most lanes are still going in early episodes, and few in late ones."""
    if not on_gpu():
        return [1]
    return [200] if name.endswith("early") else [1, 45]


def errors_of(args, name: str, means: np.ndarray) -> list[str]:
    """The distance of Q and of U from the means of NumPy, relative to their norm: median and largest."""
    with np.load(args.states / f"{name}.npz") as file:
        expected = file["reference"][np.arange(len(means)) % len(file["reference"])]
    norms = np.linalg.norm(expected, axis=1)
    errors = np.linalg.norm(means - expected, axis=1) / np.where(norms > 0.0, norms, 1.0)
    return [f"{x:.0e}" for column in errors.T for x in (np.median(column), column.max())]


def main(argv: list[str]) -> int:
    """Record the states, or time refits."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    if args.record:
        for name in args.sets:
            record(args, name)
        return 0
    if args.episodes:
        rows = measure_episodes(args)
        print_rows("Episodes of EMU-Q with direct refits", "episodes", rows, "first")
        if args.json:
            write_record(args.json, "refit", "episodes", rows, {"repeats": args.repeats, "seed": args.seed})
        return 0
    rows, cells = measure(args)
    table = Table(title=f"Direct refits of EMU-Q in float32 ({describe_device()})")
    table.add_column("")
    for name in ("transitions", "ms", "compile, s", "Q: median error", "largest", "U: median", "largest"):
        table.add_column(name, justify="right")
    for row in cells:
        table.add_row(*row)
    Console(width=130).print(table)
    if args.json:
        settings = {"sets": args.sets, "repeats": args.repeats, "seed": args.seed}
        write_record(args.json, "refit", "transitions", rows, settings)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
