"""PPO and SAC of `brax.training` on environments of bojax; their curves as a CSV file for `bojax compare`."""

import argparse
import csv
import itertools
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.agents.ppo import train as ppo
from brax.training.agents.sac import networks as sac_networks
from brax.training.agents.sac import train as sac

import bojax
from bojax.envs.brax import BojaxEnv

ENVS = ("mountain-car", "reacher")
SIZES = (64, 64)  # units of the hidden layers
TRAIN = {
    "ppo": partial(
        ppo.train,
        num_envs=8,
        unroll_length=64,  # 8 times 64 steps between two updates
        batch_size=8,
        num_minibatches=1,
        num_updates_per_batch=8,
        entropy_cost=0.01,
        network_factory=partial(
            ppo_networks.make_ppo_networks, policy_hidden_layer_sizes=SIZES, value_hidden_layer_sizes=SIZES
        ),
    ),
    "sac": partial(
        sac.train,
        num_envs=1,  # one update a step
        batch_size=128,
        min_replay_size=1000,
        max_replay_size=100_000,
        network_factory=partial(sac_networks.make_sac_networks, hidden_layer_sizes=SIZES),
    ),
}

parser = argparse.ArgumentParser()
parser.add_argument("envs", nargs="+", choices=ENVS)
parser.add_argument("--csv", type=Path, default=Path("results/deep_rl.csv"))
parser.add_argument("--steps", type=int, default=20_480)
parser.add_argument("--evaluations", type=int, default=11)
parser.add_argument("--runs", type=int, default=3)
args = parser.parse_args()

jax.config.update("jax_compilation_cache_dir", "results/jax-cache")  # later runs compile nothing


def replicated(tree, devices):
    """`jax.device_put_replicated`, which Brax 0.14 calls; JAX 0.10 lacks it (google/brax, issue 671)."""
    return jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)


jax.device_put_replicated = replicated
args.csv.parent.mkdir(parents=True, exist_ok=True)
with args.csv.open("w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["task", "label", "run", "x", "value"])
    for task, reward, name in itertools.product(args.envs, ("goal-only", "classic"), TRAIN):
        env = BojaxEnv(bojax.part(task, reward=reward))
        label = f"{name} ({reward})"
        for run in range(args.runs):
            rows = []
            TRAIN[name](
                env,
                num_timesteps=args.steps,
                episode_length=env.env.max_steps,
                learning_rate=3e-4,
                discounting=0.99,
                normalize_observations=True,
                deterministic_eval=True,
                num_eval_envs=16,
                num_evals=args.evaluations,
                seed=run,
                progress_fn=lambda steps, found, rows=rows: rows.append(
                    (int(steps), float(found["eval/episode_success"]))
                ),
            )
            table.writerows((task, label, run, *row) for row in rows)
            file.flush()
            print(f"share of episodes with success, {label} on {task}: {rows[-1][1]:.2f}", flush=True)
