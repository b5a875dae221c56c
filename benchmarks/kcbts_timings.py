"""The timings of bench_kcbts.py, run in a process with its own cores."""

import dataclasses
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from bench_kcbts import parse
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.experiments.settings import Planning
from bojax.numerics.lanes import LANES
from bojax.planning.cbts import ContinuousBeliefTreeSearch

LANES_ON_CPU = 64
"""Default number of lanes of the parking problem on a CPU (`Experiment.lanes_on_cpu`)."""


class WithoutKernel(ContinuousBeliefTreeSearch):
    """The search as a program of XLA, also on a GPU: the kernel is for no subclass."""


class Case:
    """Plans and episodes of an experiment, by default parking; every run has its own start and key."""

    def __init__(self, seed: int, planning: Planning | None = None, has_kernel: bool = True):
        self.experiment: Any = build(planning or Planning(), "float64")
        if not has_kernel:
            planner = self.experiment.planner
            fields = {field.name: getattr(planner, field.name) for field in dataclasses.fields(planner)}
            self.experiment = dataclasses.replace(self.experiment, planner=WithoutKernel(**fields))
        self._starts, self._keys = jax.random.split(jax.random.key(seed))

    def start(self, run):
        """The initial state of a run."""
        return self.experiment.problem.reset(jax.random.fold_in(self._starts, run))

    def key(self, run):
        """The key of a run."""
        return jax.random.fold_in(self._keys, run)

    def tree(self, run):
        """The search tree of a run's first plan."""
        planner, problem = self.experiment.planner, self.experiment.problem
        return planner.search(self.key(run), problem, self.start(run))[0]

    def plan(self, run):
        """The path of a run's first plan."""
        planner, problem = self.experiment.planner, self.experiment.problem
        return planner.plan(self.key(run), problem, self.start(run)).path

    def episode(self, run):
        """All paths driven in a run."""

        def advance(carry, _):
            return self.experiment.advance(carry)[0], None

        carry = self.experiment.init(self.key(run))
        carry, _ = jax.lax.scan(advance, carry, length=self.experiment.max_advances)
        return jnp.nan_to_num(carry.record.paths)


def main(argv: list[str]) -> int:
    """Check that both build the same trees, then time both."""
    args = parse(argv)
    try:
        from tests.reference.bridge import begin, reference_planner, reference_problem
        from tests.reference.compare import assert_same_tree
    except ImportError as error:
        print(f"error: {error}; run this in a clone, after pip install -e '.[test]'", file=sys.stderr)
        return 2
    jax.config.update("jax_enable_x64", True)
    case = Case(args.seed)
    planner, problem = case.experiment.planner, reference_problem(case.experiment.problem)

    references = []
    for run in range(args.plans):
        reference = reference_planner(planner, problem, *begin(planner, case.key(run)))
        start = np.asarray(case.start(run))
        tree = jax.tree.map(np.asarray, eqx.filter_jit(case.tree)(run))
        assert_same_tree(tree, reference.search(start), planner.num_actions)
        references.append((reference, start))
    print(f"{args.plans} plans: the trees are those of the NumPy reference")

    def reference_plans():
        for reference, start in references:
            reference.search(start)

    seconds = median_seconds(reference_plans, args.repeats) / args.plans
    rows = [Row("NumPy, one plan", 1, seconds, planner.iterations)]
    rows.append(time_runs("bojax, one plan", case.plan, 1, 1, planner.iterations, args.repeats))
    num_devices = jax.device_count()
    cases = {"bojax": case}
    if args.compare_xla:
        cases["XLA only"] = Case(args.seed, has_kernel=False)
    all_runs = args.runs or ([200, 1000] if on_gpu() else [200])
    for runs in all_runs:
        lanes = num_devices * (args.lanes or (-(-runs // num_devices) if on_gpu() else LANES_ON_CPU))
        for name, each in cases.items():
            rows.append(time_runs(f"{name}, plans", each.plan, runs, lanes, planner.iterations, args.repeats))
            if args.episodes or on_gpu():
                iterations = planner.iterations * case.experiment.max_advances
                rows.append(
                    time_runs(f"{name}, episodes", each.episode, runs, lanes, iterations, args.repeats)
                )

    if args.compare_xla:
        runs = max(all_runs)
        paths = [jax.jit(jax.vmap(each.plan, axis_name=LANES))(np.arange(runs)) for each in cases.values()]
        equal = np.all(np.abs(paths[0] - paths[1]) < 1e-9, axis=(1, 2))
        print(f"{np.sum(equal)} of {runs} plans are the same as a program of XLA")
    print_rows("kCBTS on the parking problem", "iterations", rows, "NumPy")
    if args.json:
        write_record(args.json, "kcbts", "iterations", rows, Planning().model_dump(mode="json"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
