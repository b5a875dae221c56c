"""The timings of bench_emu_q.py, run in a process with its own cores."""

import sys
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from bench_emu_q import parse
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.envs.settings import MountainCar
from bojax.experiments.settings import Learning
from bojax.learning.settings import EMUQ, RFFQ, RandomFourierFeatures

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from tests.reference.emu_q import PublishedCode  # noqa: E402


def make_run(args, fit: Literal["sweeps", "direct", "none"] | None):
    """A run with an episode of full length, since the car is too weak to leave the valley.

    It is a run of EMU-Q with the given refit, or of RFF-Q if this is None.
    """
    features = RandomFourierFeatures(action_lengthscale=10.0, num_features=args.features)
    learner = RFFQ(features=features, initial_weight=0.1)  # so that runs differ without any reward
    if fit is not None:
        learner = EMUQ(features=features, refit=fit, max_sweeps=args.sweeps, tolerance=0.0)
    env = MountainCar(max_steps=args.steps, power=1e-5)
    return build(Learning(dtype=args.dtype, env=env, learner=learner, episodes=1), args.dtype)


def steps_row(args, lanes: int, learner: Literal["EMU-Q", "RFF-Q"]) -> Row:
    """Time online steps, including the steps of the environment."""
    run = make_run(args, "none" if learner == "EMU-Q" else None)

    def episode(index, carry):
        carry, records = run.advance(carry)
        state = carry.learner
        weights = state.posterior.mean if learner == "EMU-Q" else state.weights
        return weights[:8], records.tables["steps"]["observation_0"][-8:]

    return time_runs(
        f"bojax, {learner}, {lanes} at once",
        episode,
        args.runs if on_gpu() else lanes,
        lanes,
        args.steps,
        args.repeats,
        prepare=lambda index: run.init(jax.random.fold_in(jax.random.key(args.seed), index)),
    )


def refit_row(args, lanes: int, how: Literal["sweeps", "direct"]) -> Row:
    """Time the refit at the end of an episode, on given transitions."""
    run = make_run(args, how)
    learner, capacity = run.learner, args.transitions
    space = run.env.observation_space

    def prepare(index):
        key = jax.random.fold_in(jax.random.key(args.seed), index)
        state = learner.init(key, space, run.env.action_space, capacity)
        # A random walk, reflected at the bounds.
        noise = jax.random.normal(jax.random.fold_in(key, 1), (capacity + 1, 2), args.dtype)
        walk = space.from_unit(jnp.abs((0.1 * jnp.cumsum(noise, axis=0)) % 2.0 - 1.0))
        memory = state.memory
        memory = type(memory)(
            observations=walk[:-1],
            actions=jax.random.uniform(jax.random.fold_in(key, 2), (capacity, 1), args.dtype, -1.0, 1.0),
            rewards=(jnp.arange(capacity) % 100 == 99).astype(args.dtype),
            next_observations=walk[1:],
            terminated=jnp.arange(capacity) % 100 == 99,
            count=jnp.asarray(capacity, jnp.int32),
        )
        phi = jax.vmap(state.features)(memory.observations, memory.actions).astype(jnp.float64)
        precision = learner.noise_precision * phi.T @ phi + learner.prior_precision * jnp.eye(args.features)
        base = jnp.linalg.inv(precision).astype(args.dtype)
        return eqx.tree_at(lambda s: (s.memory, s.posterior.base), state, (memory, base))

    def end(index, state):
        key = jax.random.fold_in(jax.random.key(args.seed), index)
        return learner.refitted(key, state, learner.exploration_weight, jnp.asarray(True))

    what = f"bojax, {how}, {lanes} at once"
    return time_runs(
        what, end, args.runs if on_gpu() else lanes, lanes, args.transitions, args.repeats, prepare=prepare
    )


def numpy_peer(args) -> tuple[Row, Row]:
    """Time online steps and the refit of the published code, in one run."""
    rng = np.random.default_rng(args.seed)
    frequencies = rng.normal(size=(args.features // 2, 3)) / np.asarray([0.3, 0.3, 10.0])
    scale = np.sqrt(2.0 / args.features)

    def phi(states, actions):
        angles = np.hstack([states, actions]) @ frequencies.T
        return scale * np.hstack([np.cos(angles), np.sin(angles)])

    agent = PublishedCode(
        phi,
        args.features,
        lambda: rng.uniform(size=(15, 1)),
        lambda: rng.uniform(size=(10, 1)),
        lengthscale=0.3,
        max_sweeps=args.sweeps,
        tolerance=0.0,
    )
    rng_steps = np.random.default_rng(1)
    walk = rng_steps.uniform(size=(args.transitions + 1, 2))
    number = min(args.steps, args.transitions)

    def online():
        for i in range(number):
            action = agent.policy(walk[i : i + 1])[0]
            agent.step(walk[i], action, 0.0, walk[i + 1], False)

    seconds = median_seconds(online, 3)
    rows = [Row("NumPy, as published", 1, seconds, number)]
    rewards = (np.arange(args.transitions) % 100 == 99).astype(float)
    actions = rng_steps.uniform(size=(args.transitions, 1))
    nothing = np.zeros(args.transitions, dtype=bool)
    seconds = median_seconds(
        lambda: agent.end_episode(walk[:-1], actions, rewards, walk[1:], nothing), min(args.repeats, 3)
    )
    rows.append(Row("NumPy, as published", 1, seconds, args.transitions))
    return rows[0], rows[1]


def main(argv: list[str]) -> int:
    """Time online steps and refits of both."""
    args = parse(argv)
    jax.config.update("jax_enable_x64", True)
    lanes = args.runs if on_gpu() else args.lanes
    peer = None if args.no_peer else numpy_peer(args)
    steps = ([peer[0]] if peer else []) + [steps_row(args, lanes, name) for name in ("EMU-Q", "RFF-Q")]
    print_rows(f"Online steps at {args.features} features, {args.dtype}", "steps", steps, steps[0].what)
    refits = ([peer[1]] if peer else []) + [
        refit_row(args, lanes, "sweeps"),
        refit_row(args, lanes, "direct"),
    ]
    title = f"Refit of {args.transitions} transitions, {args.sweeps} sweeps, {args.features} features"
    print_rows(title, "transitions", refits, refits[0].what)
    if args.json:
        names = ("features", "runs", "lanes", "steps", "transitions", "sweeps", "dtype", "seed", "repeats")
        settings = {name: getattr(args, name) for name in names}
        write_record(args.json, "emu-q", "steps", [*steps, *refits], settings)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
