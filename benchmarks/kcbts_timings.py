"""The timings of bench_kcbts.py, made in a process that was given its cores."""

import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from bench_kcbts import parse
from isolated import describe_cores
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from rich.console import Console
from rich.table import Table

from bojax.config.experiments import Planning
from bojax.engine.build import build
from bojax.engine.devices import DEFAULT_LANES


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: What was timed.
        runs: Plans, or episodes, together.
        seconds: Median over the repeats.
        iterations: Search iterations in that time; an episode that ended early counts in full.
        compile_seconds: Seconds of compilation, which are not part of `seconds`.
    """

    what: str
    runs: int
    seconds: float
    iterations: int
    compile_seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Iterations per second."""
        return self.iterations / self.seconds


class Case:
    """The experiment of the default settings: plans and episodes, each with a start and a key by its run."""

    def __init__(self, seed: int):
        self.experiment: Any = build(Planning(), "float64")
        self._starts, self._keys = jax.random.split(jax.random.key(seed))

    def start(self, run):
        """Where a run starts."""
        return self.experiment.problem.reset(jax.random.fold_in(self._starts, run))

    def key(self, run):
        """What a run draws from."""
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
        """All paths that a run drives."""

        def advance(carry, _):
            return self.experiment.advance(carry)[0], None

        carry = self.experiment.init(self.key(run))
        carry, _ = jax.lax.scan(advance, carry, length=self.experiment.max_advances)
        return jnp.nan_to_num(carry.paths)


def main(argv: list[str]) -> int:
    """Check that both do the same work, then time both."""
    args = parse(argv)
    try:
        from tests.reference.bridge import begin, reference_planner, reference_problem
        from tests.reference.compare import assert_same_tree
    except ImportError as error:
        print(f"error: {error}: needs a clone of the repository and bojax[test]", file=sys.stderr)
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

    seconds = _median_seconds(reference_plans, args.repeats) / args.plans
    rows = [Row("NumPy, one plan", 1, seconds, planner.iterations)]
    rows.append(_time("bojax, one plan", case.plan, 1, 1, planner.iterations, args.repeats))
    on_gpu = jax.default_backend() != "cpu"
    num_devices = jax.device_count()
    for runs in args.runs or ([200, 1000] if on_gpu else [200]):
        lanes = num_devices * (args.lanes or (-(-runs // num_devices) if on_gpu else DEFAULT_LANES["cpu"]))
        rows.append(_time("bojax, plans", case.plan, runs, lanes, planner.iterations, args.repeats))
        if args.episodes or on_gpu:
            iterations = planner.iterations * case.experiment.max_advances
            rows.append(_time("bojax, episodes", case.episode, runs, lanes, iterations, args.repeats))

    device = f"{num_devices} x {jax.devices()[0].device_kind}, {describe_cores()}"
    _print(rows, device)
    if args.json:
        record = {
            "benchmark": "kcbts",
            "device": device,
            "jax": jax.__version__,
            "settings": Planning().model_dump(mode="json"),
            "rows": [{**asdict(row), "iterations_per_second": row.rate} for row in rows],
        }
        args.json.write_text(json.dumps(record, indent=2) + "\n")
    return 0


def _time(what: str, function: Callable, runs: int, lanes: int, iterations: int, repeats: int) -> Row:
    """Time `runs` runs, in equal batches of at most `lanes`."""
    mesh = jax.make_mesh((1 if runs == 1 else jax.device_count(),), ("devices",), (AxisType.Auto,))
    by_lane = PartitionSpec("devices")
    num_batches = -(-runs // lanes)
    lanes = -(-runs // (num_batches * mesh.size)) * mesh.size
    index = np.arange(num_batches * lanes, dtype=np.int32).reshape(num_batches, lanes)
    batches = [jax.device_put(lane, NamedSharding(mesh, by_lane)) for lane in index]

    start = time.perf_counter()
    sharded = jax.shard_map(
        jax.vmap(function), mesh=mesh, in_specs=by_lane, out_specs=by_lane, check_vma=False
    )
    program = jax.jit(sharded).lower(batches[0]).compile()
    compile_seconds = time.perf_counter() - start

    results = np.concatenate([np.asarray(program(batch)).reshape(lanes, -1) for batch in batches])
    if len(np.unique(results, axis=0)) < len(results):
        raise AssertionError(f"{what}: two runs gave the same path: the batch is not what it seems")
    seconds = _median_seconds(lambda: [program(batch) for batch in batches], repeats)
    return Row(what, index.size, seconds, index.size * iterations, compile_seconds)


def _median_seconds(function: Callable[[], Any], repeats: int) -> float:
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function())
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def _print(rows: list[Row], device: str) -> None:
    table = Table(title=f"kCBTS on the parking problem ({device})")
    table.add_column("")
    for name in ("runs", "seconds", "compile, s", "iterations/s", "x NumPy"):
        table.add_column(name, justify="right")
    for row in rows:
        compiled = f"{row.compile_seconds:.1f}" if row.compile_seconds else ""
        ratio = f"{row.rate / rows[0].rate:.1f}"
        table.add_row(row.what, str(row.runs), f"{row.seconds:.4f}", compiled, f"{row.rate:,.0f}", ratio)
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
