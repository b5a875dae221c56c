"""Brax's PPO on the environments of the sweep study-first-result: the training steps until it finds the goal.

PPO trains for as many steps as the sweep allows a learner, `episodes` times the time limit of an episode. Its
settings are those of examples/deep_rl.py. A table of runs is written, and shares are printed.

    python benchmarks/first_result_ppo.py --csv results/ppo.csv                       # all ten, 8 runs each
    JAX_PLATFORMS=cpu python benchmarks/first_result_ppo.py wall maze --runs 32       # two of them
"""

import argparse
import csv
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs import training
from brax.envs.base import Env as BraxBase
from brax.envs.base import State, Wrapper
from brax.training.agents.ppo import networks
from brax.training.agents.ppo import train as ppo
from typing_extensions import override

import bojax
from bojax.config.yaml_file import read_mapping
from bojax.envs.brax import BojaxEnv

SWEEP = Path(__file__).parent.parent / "sweeps" / "study-first-result.yaml"
NUM_ENVS, UNROLL = 8, 64  # 8 times 64 steps between two updates
SIZES = (64, 64)  # units of the hidden layers


class FirstSuccess(Wrapper):
    """A batch of environments that tells the host in which step of all of them together a goal is reached."""

    def __init__(self, env: BraxBase, found: list[int]):
        """Wrap a batch; numbers of steps are appended to `found`."""
        super().__init__(env)
        self._found = found

    @override
    def reset(self, rng: jax.Array) -> State:
        """Start to count."""
        state = self.env.reset(rng)
        state.info["moves"] = jnp.zeros(state.done.shape, jnp.int32)
        return state

    @override
    def step(self, state: State, action: jax.Array) -> State:
        """Step, and report a success."""
        after = self.env.step(state, action)
        after.info["moves"] = moves = state.info["moves"] + 1
        jax.debug.callback(self._report, moves[0], jnp.any(after.metrics["success"] > 0))
        return after

    def _report(self, moves: Any, is_found: Any) -> None:
        if is_found:
            self._found.append(NUM_ENVS * int(moves))


def first_success(env: BojaxEnv, steps: int, seed: int) -> int | None:
    """Steps of a training of PPO until the goal is reached, or None; a multiple of the batch."""
    found: list[int] = []

    def wrapped(env: BraxBase, **options: Any) -> FirstSuccess:
        return FirstSuccess(training.wrap(env, **options), found)

    ppo.train(
        env,
        num_timesteps=steps,
        episode_length=env.env.max_steps,
        wrap_env_fn=wrapped,
        num_envs=NUM_ENVS,
        unroll_length=UNROLL,
        batch_size=NUM_ENVS,
        num_minibatches=1,
        num_updates_per_batch=8,
        learning_rate=3e-4,
        entropy_cost=0.01,
        discounting=0.99,
        normalize_observations=True,
        network_factory=partial(
            networks.make_ppo_networks, policy_hidden_layer_sizes=SIZES, value_hidden_layer_sizes=SIZES
        ),
        run_evals=False,
        num_eval_envs=NUM_ENVS,
        seed=seed,
    )
    jax.effects_barrier()
    # The last iteration may go beyond the budget.
    return min((each for each in found if each <= steps), default=None)


def main() -> None:
    """Train on each environment, several times."""
    sweep = read_mapping(SWEEP, SWEEP.name)
    envs = sweep["axes"]["env"]
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("envs", nargs="*", help=f"environments, all by default: {', '.join(envs)}")
    parser.add_argument("--runs", type=int, default=8, help="runs on each environment (8)")
    parser.add_argument(
        "--csv", type=Path, default=Path("results/first-result-ppo.csv"), help="table of runs"
    )
    args = parser.parse_args()
    if unknown := set(args.envs) - set(envs):
        parser.error(f"got {', '.join(sorted(unknown))}; allowed: {', '.join(envs)}")
    # Brax 0.14 calls a function of JAX that JAX 0.10 lacks (google/brax, issue 671).
    jax.device_put_replicated = lambda tree, devices: jax.tree.map(
        lambda leaf: jnp.stack([leaf] * len(devices)), tree
    )
    args.csv.parent.mkdir(parents=True, exist_ok=True)
    with args.csv.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["env", "run", "success", "steps_to_goal", "steps"])
        for name in args.envs or envs:
            settings = dict(envs[name])
            part = bojax.part(settings.pop("kind"), **settings)
            steps, found = sweep["base"]["episodes"] * part.max_steps, []
            for run in range(args.runs):
                found.append(first_success(BojaxEnv(part), steps, run))
                table.writerow([name, run, found[-1] is not None, found[-1], steps])
                file.flush()
            share = sum(each is not None for each in found) / args.runs
            print(f"{name}: {share:.0%} of {args.runs} runs find the goal in {steps:,} steps", flush=True)


if __name__ == "__main__":
    main()
