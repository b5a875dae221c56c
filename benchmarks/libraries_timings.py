"""The timings of bench_libraries.py, run in a process with its own cores."""

import importlib.metadata
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from bench_libraries import parse
from peers import installed, print_ratios
from timing import Row, median_seconds, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.envs.gymnax import GymnaxEnv
from bojax.envs.settings import MountainCar
from bojax.experiments.settings import Planning
from bojax.planning.settings import SBO

LIBRARIES = "gymnasium", "gymnax", "mctx"


def main(argv: list[str]) -> int:
    """Time steps of the environment, then plans."""
    args = parse(argv)
    rows = environment_rows(args)
    print_rows("MountainCarContinuous, random actions", "steps", rows, rows[0].what)
    print_ratios(rows, {})
    plans = plan_rows(args)
    print_rows("Tree search on parking", "iterations", plans, plans[0].what)
    print_ratios(plans, {})
    if args.json:
        settings = {name: getattr(args, name) for name in ("lanes", "steps", "iterations", "seed", "repeats")}
        write_record(args.json, "libraries", "work", [*rows, *plans], settings | {"versions": versions()})
    return 0


def versions() -> dict[str, str]:
    """The versions of the libraries that are installed."""
    found = {each.metadata["name"].lower(): each.version for each in importlib.metadata.distributions()}
    return {name: found[name] for name in LIBRARIES if name in found}


def environment_rows(args) -> list[Row]:
    """Steps of the environment, in each library and with each number at once."""
    rows = []
    for make in installed({"Gymnasium": ("gymnasium", lambda: gymnasium_vector)}).values():
        rows += [gymnasium_row(args, make(lanes), lanes) for lanes in args.lanes]
    ours = GymnaxEnv(build(MountainCar(power=0.0015, goal_position=0.45, max_steps=999), "float32"))
    made = installed({"gymnax": ("gymnax", load_gymnax)}) | {"bojax": (ours, ours.default_params)}
    for name, (env, params) in made.items():

        def run(index, env=env, params=params):
            key, key_reset = jax.random.split(jax.random.fold_in(jax.random.key(args.seed), index))
            observation, state = env.reset(key_reset, params)

            def step(carry, key):
                key_action, key_step = jax.random.split(key)
                action = jax.random.uniform(key_action, (1,), jnp.float32, -1.0, 1.0)
                return env.step(key_step, carry[1], action, params)[:2], None

            return jax.lax.scan(step, (observation, state), jax.random.split(key, args.steps))[0][0]

        for lanes in args.lanes:
            rows.append(time_runs(f"{name}, {lanes} at once", run, lanes, lanes, args.steps, args.repeats))
    return rows


def load_gymnax() -> tuple[Any, Any]:
    """The environment of gymnax, and its parameters."""
    import gymnax  # pyright: ignore[reportMissingImports]

    return gymnax.make("MountainCarContinuous-v0")


def gymnasium_vector(lanes: int) -> Any:
    """Gymnasium's vector environment, which steps one environment after the other."""
    import gymnasium

    return gymnasium.make_vec("MountainCarContinuous-v0", lanes, vectorization_mode="sync")


def gymnasium_row(args, env: Any, lanes: int) -> Row:
    """Time steps of a vector environment of Gymnasium."""
    actions = np.random.default_rng(args.seed).uniform(-1.0, 1.0, (args.steps, lanes, 1)).astype(np.float32)

    def episode() -> None:
        env.reset(seed=args.seed)
        for action in actions:
            env.step(action)

    seconds = median_seconds(episode, args.repeats)
    return Row(f"Gymnasium, {lanes} at once", lanes, seconds, lanes * args.steps)


def plan_rows(args) -> list[Row]:
    """Plans of bojax and of mctx for the first state of a run."""
    experiment: Any = build(Planning(planner=SBO(iterations=args.iterations)), "float32")
    planner, problem = experiment.planner, experiment.problem

    def start(run):
        return problem.reset(jax.random.fold_in(jax.random.key(args.seed), run))

    def plan(run):
        key = jax.random.fold_in(jax.random.key(args.seed + 1), run)
        tree, memory = planner.search(key, problem, start(run))
        return planner.recommend(tree, memory), tree.totals  # two runs may recommend the same action

    rows = []
    for make in installed({"mctx": ("mctx", lambda: mctx_plans)}).values():
        plans = jax.jit(make(planner, problem))
        for lanes in args.lanes:
            poses = jax.vmap(start)(jnp.arange(lanes))
            jax.block_until_ready(plans(poses, jax.random.key(args.seed)))  # compiles
            seconds = median_seconds(lambda: plans(poses, jax.random.key(args.seed)), args.repeats)  # noqa: B023
            rows.append(Row(f"mctx, {lanes} at once", lanes, seconds, lanes * args.iterations))
    for lanes in args.lanes:
        what = f"bojax, {lanes} at once"
        rows.append(time_runs(what, plan, lanes, lanes, args.iterations, args.repeats))
    return rows


def mctx_plans(planner: Any, problem: Any) -> Callable:
    """Actions that MuZero's search of mctx chooses at poses `[B, 3]`, in the same simulations."""
    import mctx  # pyright: ignore[reportMissingImports]

    count, depth = int(planner.motions.count), planner.depth
    paths = planner.motions.paths()

    def simulate(key, action, pose, level):
        rollout = jax.random.randint(key, (depth - 1,), 0, count, action.dtype)
        found = problem.simulate(key, None, pose, paths[jnp.append(action, rollout)], None)
        # Rewards up to the horizon, of which the first is the reward of the action.
        counts = level + jnp.arange(depth) < depth
        ended = jnp.cumsum(found.terminated) - found.terminated > 0
        rewards = jnp.where(counts & ~ended, found.rewards, 0.0)
        return rewards[0], jnp.sum(rewards[1:]), found.terminated[0], found.node

    def recurrent(params, key, action, embedding):
        poses, levels = embedding
        keys = jax.random.split(key, len(poses))
        reward, value, ended, poses = jax.vmap(simulate)(keys, action, poses, levels)
        output = mctx.RecurrentFnOutput(
            reward=reward,
            discount=jnp.where(ended, 0.0, 1.0).astype(reward.dtype),
            prior_logits=jnp.zeros((len(poses), count), reward.dtype),
            value=value,
        )
        return output, (poses, levels + 1)

    def plans(poses, key):
        lanes, dtype = len(poses), poses.dtype
        root = mctx.RootFnOutput(
            prior_logits=jnp.zeros((lanes, count), dtype),
            value=jnp.zeros(lanes, dtype),
            embedding=(poses, jnp.zeros(lanes, jnp.int32)),
        )
        found = mctx.muzero_policy(
            None, key, root, recurrent, planner.iterations, max_depth=depth, dirichlet_fraction=0.0
        )
        return found.action, found.action_weights

    return plans


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
