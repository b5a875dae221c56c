"""Iterations/s of POMCPOW and PFT-DPW of POMDPPlanners on VDP Tag, in an environment of its own.

    python3.11 -m venv /tmp/peer
    /tmp/peer/bin/pip install POMDPPlanners==0.6.0
    /tmp/peer/bin/python benchmarks/pomdpplanners_vdp_tag.py

It depends on PyTorch, MLflow, Ray and Dask, so that bojax's own environment does not have it. The model is
that of `pomdp_py_vdp_tag.py` with continuous actions and observations, in plain Python numbers; constants are
the published ones, as in `bench_pomdp.py`. Rates are per second of processor time of the thread that plans.
"""

import argparse
import importlib
import json
import math
import random
import statistics
import time
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from typing import Any

import numpy as np
import vdp_tag_scalars as vdp_tag

PACKAGE = "POMDPPlanners"
NUM_PARTICLES, DEPTH = 1000, 10
State = Sequence[float]
Action = tuple[float, bool]


def _module(name: str) -> Any:
    return importlib.import_module(f"{PACKAGE}.{name}")  # it is not installed where types are checked


def _positions(state: State) -> tuple[vdp_tag.Point, vdp_tag.Point]:
    return (state[0], state[1]), (state[2], state[3])


def make_environment() -> Any:
    """VDP Tag as an environment of POMDPPlanners; a state is both positions, then 1 if tagged."""
    core, distributions = _module("core.environment"), _module("core.distributions")

    class Start(distributions.Distribution):
        def sample(self, n_samples: int = 1) -> list[State]:
            def side():
                return random.uniform(-4.0, 4.0)

            return [(0.0, 0.0, side(), side(), 0.0) for _ in range(n_samples)]

    class VdpTag(core.Environment):
        def __init__(self) -> None:
            continuous = core.SpaceType.CONTINUOUS
            super().__init__(0.95, "vdp-tag", core.SpaceInfo(continuous, continuous))

        def sample_next_state(self, state: State, action: Action, n_samples: int = 1) -> Any:
            drawn = []
            for _ in range(n_samples):
                agent, target, is_tagged = vdp_tag.step(*_positions(state), action[0])
                drawn.append((*agent, *target, float(is_tagged)))
            return drawn[0] if n_samples == 1 else drawn

        def sample_observation(self, next_state: State, action: Action, n_samples: int = 1) -> Any:
            drawn = [vdp_tag.readings(*_positions(next_state), action[1]) for _ in range(n_samples)]
            return drawn[0] if n_samples == 1 else drawn

        def observation_log_probability_single(
            self, next_state: State, action: Action, observation: list[float]
        ) -> float:
            return vdp_tag.log_density(observation, *_positions(next_state), action[1])

        def observation_log_probability(
            self, next_state: State, action: Action, observations: list[list[float]]
        ) -> np.ndarray:
            own = self.observation_log_probability_single
            return np.array([own(next_state, action, observation) for observation in observations])

        def reward(self, state: State, action: Action, next_state: State | None = None) -> float:
            after = self.sample_next_state(state, action) if next_state is None else next_state
            return vdp_tag.reward(after[4] > 0.0, action[1])

        def is_terminal(self, state: State) -> bool:
            return state[4] > 0.0

        def initial_state_dist(self) -> Any:
            return Start()

        def initial_observation_dist(self) -> Any:
            raise NotImplementedError("neither planner asks for a first observation")

        def transition_log_probability(self, state: State, action: Action, next_states: Any) -> np.ndarray:
            raise NotImplementedError("neither planner asks for densities of states")

        def is_equal_observation(self, observation1: list[float], observation2: list[float]) -> bool:
            return observation1 == observation2

        def hash_observation(self, observation: list[float]) -> tuple[float, ...]:
            return tuple(observation)

        def hash_action(self, action: Action) -> Action:
            return action

    return VdpTag()


def make_planner(name: str, iterations: int) -> Any:
    """A planner with the published constants."""

    class Sampler(_module("planners.planners_utils.dpw").ActionSampler):
        def sample(self, belief_node: Any = None) -> Action:
            return random.uniform(0.0, 2.0 * math.pi), random.random() < 0.5

    pomcpow = {"exploration_constant": 110.0, "k_a": 30.0, "alpha_a": 1 / 30, "k_o": 5.0, "alpha_o": 0.01}
    pft = {"exploration_constant": 70.0, "k_a": 20.0, "alpha_a": 1 / 25, "k_o": 8.0, "alpha_o": 1 / 85}
    module, kind, constants = {
        "POMCPOW": ("pomcpow", "POMCPOW", pomcpow),
        "PFT-DPW": ("pft_dpw", "PFT_DPW", pft),
    }[name]
    return getattr(_module(f"planners.mcts_planners.{module}"), kind)(
        environment=make_environment(),
        discount_factor=0.95,
        depth=DEPTH,
        name=name,
        action_sampler=Sampler(),
        n_simulations=iterations,
        **constants,
    )


def main() -> None:
    """Time both planners, and print a record."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--iterations", type=int, default=1000, help="simulations of a plan (1000)")
    parser.add_argument("--repeats", type=int, default=5, help="plans, of which the median counts (5)")
    args = parser.parse_args()
    beliefs, rates = _module("core.belief"), {}
    for name, particles in (("POMCPOW", NUM_PARTICLES), ("PFT-DPW", 20)):
        random.seed(0)
        planner = make_planner(name, args.iterations)
        belief = beliefs.get_initial_belief(planner.environment, particles)
        planner.action(belief)  # imports and first calls
        seconds = []
        for _ in range(args.repeats):
            start = time.process_time()
            planner.action(belief)
            seconds.append(time.process_time() - start)
        rates[name] = round(args.iterations / statistics.median(seconds))
    described = {"package": PACKAGE, "version": version(PACKAGE), "date": date.today().isoformat()}
    print(json.dumps(described | {"iterations": args.iterations, "depth": DEPTH, "iterations_per_s": rates}))


if __name__ == "__main__":
    main()
