"""The timings of bench_field.py, run in a process with its own cores."""

import dataclasses
import functools
import sys
from typing import Any

import equinox as eqx
import jax
import numpy as np
from bench_field import parse
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.experiments.settings import Planning
from bojax.models.gaussian_process import GaussianProcess

NUM_OBSERVATIONS = 192
NUM_SAMPLES = 8
LANES = 8
"""Runs at once on a CPU core; the factors of more runs do not fit into its cache."""


def settings(objective: str, observations: int = NUM_OBSERVATIONS, iterations: int = 300) -> Planning:
    """An experiment with room for one more drive than made the observations, 8 a drive."""
    max_steps = observations // NUM_SAMPLES + 1
    return Planning.model_validate(
        {
            "problem": {"kind": "space-modelling", "objective": objective, "max_steps": max_steps},
            "planner": {
                "kind": "kcbts",
                "iterations": iterations,
                "depth": 3,
                "max_actions": 20,
                "exploration": 150.0,
                "motions": {"kind": "kernel", "num_samples": NUM_SAMPLES},
            },
        }
    )


class Case:
    """Plans near the end of an episode; every run has its own observations and key."""

    def __init__(self, planning: Planning, seed: int, observations: int = NUM_OBSERVATIONS):
        experiment: Any = build(planning, "float64")
        self.observations = observations
        self.planner, self.problem = experiment.planner, experiment.problem
        self._data, self._keys = jax.random.split(jax.random.key(seed))

    def belief(self, run):
        """The belief of a run: observations at points drawn from the domain, and a pose that is free."""
        keys = jax.random.split(jax.random.fold_in(self._data, run), 4)
        problem = eqx.tree_at(lambda p: p.start, self.problem, None)
        belief = problem.prior(keys[0], problem.reset(keys[1]), NUM_SAMPLES)
        low, high = problem.domain[:2], problem.domain[2:]
        x = jax.random.uniform(keys[2], (self.observations, 2), low.dtype, low, high)
        y = problem.field.values(x) + problem.noise * jax.random.normal(keys[3], (self.observations,))
        prior = belief.posterior
        capacity = prior.y.shape[0]
        posterior = GaussianProcess.fit(
            prior.kernel, prior.noise_variance, x, y, mean=prior.mean, capacity=capacity
        )
        return eqx.tree_at(lambda b: b.posterior, belief, posterior)

    def key(self, run):
        """The key of a run."""
        return jax.random.fold_in(self._keys, run)

    def tree(self, run, belief):
        """The search tree of a run's plan."""
        return self.planner.search(self.key(run), self.problem, belief)[0]

    def plan(self, run, belief):
        """The path of a run's plan, and its expected value."""
        plan = self.planner.plan(self.key(run), self.problem, belief)
        return plan.path, plan.value


class Eager:
    """A reference problem that fits every belief at once, whether it is used or not."""

    def __init__(self, problem: Any):
        self.problem = problem

    def drive(self, *arguments):
        """Drive a path and fit the belief after it."""
        belief, reward, is_terminal = self.problem.drive(*arguments)
        _ = belief.gp
        return belief, reward, is_terminal


def main(argv: list[str]) -> int:
    """Check that both build the same trees, then time both."""
    args = parse(argv)
    try:
        from tests.reference import bridge
        from tests.reference.compare import assert_same_tree
    except ImportError as error:
        print(f"error: {error}; run this in a clone, after pip install -e '.[test]'", file=sys.stderr)
        return 2
    jax.config.update("jax_enable_x64", True)
    rows: list[Row] = []
    for objective in args.objectives:
        case = Case(settings(objective), args.seed)
        planner, problem = case.planner, case.problem
        references = []
        for run in range(args.plans):
            belief = jax.jit(case.belief)(run)
            memory, draws = bridge.begin(planner, case.key(run))
            reference = bridge.reference_planner(
                planner,
                bridge.reference_problem(problem, planner),
                memory,
                draws,
                bridge.drawn(planner, problem, case.key(run)),
            )
            start = bridge.reference_belief(belief)
            tree = jax.tree.map(np.asarray, eqx.filter_jit(case.tree)(run, belief))
            assert_same_tree(tree, reference.search(start), planner.num_actions)
            references.append((reference, start))
        print(f"{objective}, {args.plans} plans: the trees are those of the NumPy reference")

        def reference_plans(fit, references=references):
            for reference, start in references:
                problem = reference.problem
                reference.problem = Eager(problem) if fit == "each belief" else problem
                reference.search(dataclasses.replace(start))  # a copy has no cached factors
                reference.problem = problem

        own = []
        for fit in ("each belief", "on demand"):
            seconds = median_seconds(functools.partial(reference_plans, fit), args.repeats) / args.plans
            own.append(Row(f"{objective}: NumPy, fits {fit}", 1, seconds, planner.iterations))
        num_devices = jax.device_count()
        sizes = args.runs or ([200, 1000] if on_gpu() else [200])
        for name, runs in [("one plan", 1)] + [("plans", runs) for runs in sizes]:
            lanes = num_devices * (args.lanes or (-(-runs // num_devices) if on_gpu() else LANES))
            row = time_runs(
                f"{objective}: bojax, {name}",
                case.plan,
                runs,
                min(runs, lanes),
                planner.iterations,
                args.repeats,
                prepare=case.belief,
            )
            own.append(row)
            if on_gpu():
                found = [device.memory_stats() for device in jax.devices()]  # not every allocator has them
                peak = max((stats["peak_bytes_in_use"] for stats in found if stats), default=0)
                if peak:
                    print(f"{row.what}, {runs} runs: peak memory of a device so far {peak / 1e9:.2f} GB")
        print_rows(f"kCBTS on a field, {objective}", "iterations", own, "NumPy")
        rows += own
    if args.json:
        described = {objective: settings(objective).model_dump(mode="json") for objective in args.objectives}
        write_record(args.json, "field", "iterations", rows, described)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
