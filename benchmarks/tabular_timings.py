"""The timings of bench_tabular.py, run in a process with its own cores."""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
from bench_tabular import parse
from peers import installed, print_ratios
from timing import Row, median_seconds, on_gpu, print_rows, write_record

from bojax.engine.build import build
from bojax.envs.settings import Taxi
from bojax.experiments import learning, phases
from bojax.experiments.settings import Learning
from bojax.learning.settings import AdditiveRewards, EpsilonGreedy, ExplorationValues
from bojax.numerics.lanes import LANES

LEARNERS = ExplorationValues, AdditiveRewards, EpsilonGreedy

EPISODES = 3
"""Number of episodes that are timed together."""


def main(argv: list[str]) -> int:
    """Time episodes of each learner, as a kernel and as a program of XLA."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", args.dtype == "float64")
    rows = list(installed({"Gymnasium and NumPy": ("gymnasium", lambda: gymnasium_row(args))}).values())
    ways = {"a kernel": phases.run_episode} if on_gpu() else {}
    ways["XLA"] = phases.run_in_blocks
    for lanes in args.lanes:
        for make in LEARNERS:
            found = {}
            for way, run_episode in ways.items():
                learning.run_episode = run_episode
                row, found[way] = learner_row(args, make(ties="first"), lanes, way)
                rows.append(row)
            if len(found) > 1:
                tables = np.asarray(found["a kernel"]), np.asarray(found["XLA"])
                differ = np.any(tables[0] != tables[1], axis=(1, 2, 3)).sum()
                print(f"{make().kind}: tables of {differ} of {lanes} runs differ between both ways")
    print_rows("Tabular Q-learning on taxi", "steps", rows, rows[0].what)
    print_ratios(rows, {})
    if args.json:
        settings = {name: getattr(args, name) for name in ("lanes", "steps", "tests", "dtype", "seed")}
        write_record(args.json, "tabular", "steps", rows, settings)
    return 0


def learner_row(args, learner, lanes: int, way: str) -> tuple[Row, jax.Array]:
    """Time a few episodes of all runs; the tables after the first of them come with the row."""
    settings = Learning(
        env=Taxi(max_steps=args.steps), learner=learner, episodes=100, tests=args.tests, dtype=args.dtype
    )
    run = build(settings, args.dtype)
    keys = jax.random.split(jax.random.key(args.seed), lanes)
    first = jax.jit(jax.vmap(run.init, axis_name=LANES))(keys)

    def episodes(carry):
        carry, records = jax.lax.scan(lambda carry, _: run.advance(carry), carry, length=EPISODES)
        return carry, jnp.sum(records.active_steps)

    start = time.perf_counter()
    program = jax.jit(jax.vmap(episodes, axis_name=LANES)).lower(first).compile()
    seconds = time.perf_counter() - start
    carry, steps = program(first)
    tables = carry.learner.columns
    assert len(np.unique(np.asarray(tables), axis=0)) == lanes, "two runs gave the same result"
    timed = median_seconds(lambda: program(first), args.repeats)
    what = f"bojax, {learner.kind}, as {way}"
    return Row(what, lanes, timed, int(steps.sum()), seconds), tables


def gymnasium_row(args) -> Row:
    """Time Q-learning as it is usually written, without tests; epsilon is 0.1."""
    import gymnasium

    env = gymnasium.make("Taxi-v4", max_episode_steps=args.steps).unwrapped
    rng, q = np.random.default_rng(args.seed), np.zeros((500, 6))
    state, _ = env.reset(seed=args.seed)

    def steps(number: int) -> None:
        nonlocal state
        for _ in range(number):
            action = int(rng.integers(6)) if rng.random() < 0.1 else int(np.argmax(q[state]))
            after, reward, terminated, _, _ = env.step(action)
            target = float(reward) + 0.99 * (0.0 if terminated else np.max(q[after]))
            q[state, action] += 0.1 * (target - q[state, action])
            state = env.reset()[0] if terminated else after

    number = 10 * args.steps
    return Row("Gymnasium and NumPy", 1, median_seconds(lambda: steps(number), args.repeats), number)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
