"""A plan of kCBTS on parking as one kernel of a GPU, beside the engine's program.

In the engine, an iteration of the search is some 33 kernels, each of which waits for the one before. Here a
lane is one program of a kernel written in Pallas, with the loop over the iterations inside. The tree lies in
the results of the kernel, which are in the caches; the random numbers are drawn, and the paths of the
candidates are computed, before. `bojax` does not use it.

Both programs compute in float32, with the same random numbers, those of `planner.begin`. The times of both
include drawing these and computing the paths; `begin` is the time of that alone. The simulation of parking
draws nothing. The two plans of a run are the same unless rounding decides between two actions: how many are
the same is printed.

Without a GPU, the kernel is interpreted, and only its results are compared:

    python benchmarks/kcbts_kernel.py --runs 2 --iterations 20
"""

import argparse
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from timing import median_seconds, on_gpu

from bojax.acquisition.functions import UpperConfidenceBound
from bojax.engine.build import build
from bojax.experiments.settings import Planning
from bojax.models.kernels import RBF
from bojax.numerics.lanes import LANES
from bojax.numerics.linalg import noise_floor
from bojax.numerics.pallas import imported, launch
from bojax.planning.settings import KCBTS
from bojax.planning.tree import ROOT, UNVISITED

X, Y, HEADING, REWARD, IS_OVER, VISITS, RETURN, IS_FULL = range(NUM_COLUMNS := 8)
"""Columns of `Tree.numbers`."""


class Given(NamedTuple):
    """What the search of a lane reads: its start, and the numbers of `planner.begin`."""

    start: Any  # pose of the root, [3]
    candidates: Any  # parameters of the candidates, [D, C]
    paths: Any  # x, y and heading of their paths, [3, C, S], the last pose repeated
    rollout: Any  # candidates that the rollouts follow, [I, H - 1]
    initial: Any  # candidates that nodes with few actions try, [I]


class Tree(NamedTuple):
    """The tree of a lane: a node and the action that leads to it have one row, and the root has the first."""

    children: Any  # children of each node in the order of their addition, or `UNVISITED`, [N, A]
    parent: Any  # [N]
    candidate: Any  # the action, [N]
    numbers: Any  # pose, outcome, totals, and whether it has all its children, [N, NUM_COLUMNS]
    factor: Any  # row of the action in the inverse Cholesky factor of its node, [N, A]
    whitened: Any  # row of the action in the whitened covariances of the candidates, [N, C]


class Search:
    """Algorithms 3 and 4 on parking, in operations that a kernel has, on references to its memory."""

    def __init__(self, run, rows: int):
        self.rows = rows  # number of children whose rows are read at once
        planner, problem = run.planner, run.problem
        assert isinstance(planner.acquisition, UpperConfidenceBound) and isinstance(planner.kernel, RBF)
        assert planner.acquisition.uncertainty == "std" and planner.scaling == "standardise"
        assert planner.refine_steps == 0 and bool(problem.rule.is_("printed"))
        assert problem.bearing == "world" and bool(problem.exit_terminates)
        self.iterations, self.depth, self.num_initial = planner.iterations, planner.depth, planner.num_initial
        self.num_candidates, self.num_actions = planner.num_candidates, int(jnp.sum(planner.max_actions))
        self.discount, self.exploration = float(planner.discount), float(planner.exploration)
        self.convergence, self.kappa = float(planner.convergence), float(planner.acquisition.kappa)
        self.lengthscale = float(planner.kernel.lengthscale)
        self.noise = max(float(planner.noise_variance), noise_floor(jnp.float32))
        names = "half_width", "distance_tolerance", "heading_tolerance", "bearing_tolerance"
        self.half_width, self.near, self.aligned, self.on_axis = (float(getattr(problem, n)) for n in names)
        self.success, self.exit = float(problem.success_reward), float(problem.exit_reward)

    def __call__(self, given: Given, tree: Tree) -> None:
        """All iterations."""
        tree.children[ROOT, :], tree.factor[ROOT, :] = _zeros(tree.children), _zeros(tree.factor)
        tree.whitened[ROOT, :], tree.candidate[ROOT] = _zeros(tree.whitened), jnp.int32(0)
        self._write(tree, ROOT, given.start[X], given.start[Y], given.start[HEADING])

        def iterate(i, carry):
            _wait()
            node, level = self.descend(tree)
            is_new = (level < self.depth) & (tree.numbers[node, IS_OVER] == 0.0)
            jax.lax.cond(
                is_new,
                lambda: self.expand(given, tree, i, node, level),
                lambda: self.back_up(tree, node, jnp.float32(0.0)),
            )
            return carry

        jax.lax.fori_loop(0, self.iterations, iterate, 0)

    def descend(self, tree: Tree):
        """The node where the search tries a new action, and its level (`TreePolicy`)."""

        def body(carry):
            node, level, _ = carry
            child = self.best_child(tree, node)
            return child, level + 1, tree.numbers[child, IS_FULL]

        first = jnp.int32(ROOT), jnp.int32(0), tree.numbers[ROOT, IS_FULL]
        node, level, _ = jax.lax.while_loop(lambda carry: carry[2] > 0.0, body, first)
        return node, level

    def best_child(self, tree: Tree, node):
        """The child of highest upper bound (4.1)."""
        children = tree.children[node, :]
        visits, returns = tree.numbers[children, VISITS], tree.numbers[children, RETURN]
        tries = jnp.log(jnp.maximum(tree.numbers[node, VISITS], 1.0))
        bounds = returns / visits + self.exploration * jnp.sqrt(tries / visits)
        return tree.children[node, _first_maximum(jnp.where(children != UNVISITED, bounds, -jnp.inf))]

    def expand(self, given: Given, tree: Tree, i, node, level) -> None:
        """Add a child, with the rewards of its action and of a rollout from there, and back up."""
        candidate, place, rows, has_converged = self.propose(given, tree, i, node)
        is_full = (place + 1 == self.num_actions) | has_converged  # line 12 of Algorithm 4
        pose = tuple(tree.numbers[node, column] for column in (X, Y, HEADING))
        driven = [self.drive(given, pose, candidate)]
        for step in range(self.depth - 1):
            driven.append(self.drive(given, driven[-1][2], given.rollout[i, step]))
        future = jnp.float32(0.0)
        for step, (reward, is_over, _) in reversed(list(enumerate(driven))):
            later = jnp.where(is_over, 0.0, self.discount * future)
            future = jnp.where(step < self.depth - level, reward + later, 0.0)
        child, (reward, is_over, pose) = i + 1, driven[0]
        tree.children[child, :] = _zeros(tree.children)
        tree.parent[child], tree.candidate[child] = node, candidate
        tree.factor[child, :], tree.whitened[child, :] = rows
        self._write(tree, child, *pose, reward, _number(is_over), 1.0, future)
        self.back_up(tree, node, future)
        tree.children[node, place], tree.numbers[node, IS_FULL] = child, _number(is_full)

    def propose(self, given: Given, tree: Tree, i, node):
        """The candidate to try, its place, its rows in the node's model, and whether the node converges."""
        children = tree.children[node, :]
        exists, place = children != UNVISITED, jax.lax.iota(jnp.int32, children.shape[0])
        count = jnp.sum(exists.astype(jnp.int32))
        rewards, number = tree.numbers[children, REWARD], jnp.maximum(_number(count), 1.0)
        mean = jnp.sum(jnp.where(exists, rewards, 0.0)) / number
        variance = jnp.sum(jnp.where(exists, (rewards - mean) * (rewards - mean), 0.0)) / number
        deviation = jnp.where(variance > 1e-12 * (mean * mean), jnp.sqrt(variance), 1.0)
        y = jnp.where(exists, (rewards - mean) / deviation, 0.0)

        def explain(known, sums):
            whitened = tree.whitened[known, :]
            residuals = jnp.sum(tree.factor[known, :] * y[None, :], axis=1)
            return sums[0] + residuals[:, None] * whitened, sums[1] + whitened * whitened

        def project(known, sums):
            own = tree.whitened[known, candidate][:, None]
            return sums[0] + own * tree.whitened[known, :], sums[1] + own * tree.factor[known, :]

        widths = tree.whitened.shape[1], children.shape[0]
        mean, explained = self._over_children(tree, node, count, explain, widths[0], widths[0])
        scores = mean + self.kappa * jnp.sqrt(jnp.maximum(1.0 - explained, 0.0))
        is_candidate = jax.lax.iota(jnp.int32, widths[0]) < self.num_candidates
        best = _first_maximum(jnp.where(is_candidate, scores, -jnp.inf))
        candidate = jnp.where(count < self.num_initial, given.initial[i], best)

        # What the action appends to the model (`GaussianProcess.next_row` and `next_whitened`).
        own = tree.whitened[children, candidate]
        pivot = jnp.sqrt(jnp.maximum(1.0 + self.noise - jnp.sum(own * own), self.noise))
        shared, row = self._over_children(tree, node, count, project, *widths)
        row = jnp.where(place == count, 1.0, -row) / pivot
        dimensions = range(given.candidates.shape[0])
        away = [given.candidates[d, :] - given.candidates[d, candidate] for d in dimensions]
        covariances = jnp.exp(-0.5 * sum((a / self.lengthscale) * (a / self.lengthscale) for a in away))
        next_whitened = (covariances - shared) / pivot

        previous = tree.candidate[jnp.max(children)]  # a later node has a higher index
        moved = [given.candidates[d, candidate] - given.candidates[d, previous] for d in dimensions]
        has_converged = (count > 0) & (jnp.sqrt(sum(m * m for m in moved)) < self.convergence)
        return candidate, count, (row, next_whitened), has_converged

    def _over_children(self, tree: Tree, node, count, add, *widths):
        """Sums over the children of a node; `add` adds what is known of a few of them at once."""
        pallas, _ = imported()

        # The rows of a missing child are those of the root, which are zero.
        def body(block, sums):
            return add(tree.children[node, pallas.ds(block * self.rows, self.rows)], sums)

        zeros = tuple(jnp.zeros((self.rows, width), jnp.float32) for width in widths)
        number = jax.lax.div(count + (self.rows - 1), jnp.int32(self.rows))
        return [jnp.sum(each, axis=0) for each in jax.lax.fori_loop(0, number, body, zeros)]

    def drive(self, given: Given, pose, candidate):
        """The reward (4.13) of a path, whether the episode is over, and the pose at the end."""
        (x0, y0, heading), last = pose, given.paths.shape[2] - 1
        cos, sin = jnp.cos(heading), jnp.sin(heading)

        def place(samples):
            ahead, left = given.paths[X, candidate, samples], given.paths[Y, candidate, samples]
            return x0 + cos * ahead - sin * left, y0 + sin * ahead + cos * left

        xs, ys = place(slice(None))
        exited = jnp.max(jnp.maximum(jnp.abs(xs), jnp.abs(ys))) > self.half_width
        (x, y), heading = place(last), heading + given.paths[HEADING, candidate, last]
        distance, off_heading = jnp.sqrt(x * x + y * y), jnp.abs(jnp.sin(heading))
        off_axis = jnp.abs(y) / jnp.where(distance > 0.0, distance, 1.0)
        is_aligned, is_on_axis = off_heading <= self.aligned, off_axis <= self.on_axis
        is_parked = (distance <= self.near) & is_aligned & is_on_axis & ~exited
        farthest = 2.0**0.5 * self.half_width
        shaped = jnp.where(is_aligned, -distance, -off_heading - farthest)
        shaped = jnp.where(is_on_axis, shaped, -off_axis - farthest - 1.0)
        reward = jnp.where(exited, self.exit, jnp.where(is_parked, self.success, shaped))
        return reward, exited | is_parked, (x, y, heading)

    def back_up(self, tree: Tree, node, future) -> None:
        """Credit the actions from `node` to the root with their rewards and the return after them."""
        _wait()  # until nothing reads the rows of earlier nodes

        def credit(node, gain):
            tree.numbers[node, VISITS] = tree.numbers[node, VISITS] + 1.0
            tree.numbers[node, RETURN] = tree.numbers[node, RETURN] + gain

        def body(carry):
            node, gain = carry
            gain = tree.numbers[node, REWARD] + self.discount * gain
            credit(node, gain)
            return tree.parent[node], gain

        _, gain = jax.lax.while_loop(lambda carry: carry[0] != ROOT, body, (node, future))
        credit(ROOT, gain)

    def _write(self, tree: Tree, node, *numbers) -> None:
        for column in range(NUM_COLUMNS):
            tree.numbers[node, column] = jnp.float32(numbers[column] if column < len(numbers) else 0.0)


def _wait() -> None:
    """Wait until all threads have read, or written, the tree; an interpreted kernel has only one."""
    if on_gpu():
        imported()[1].debug_barrier()


def _zeros(rows):
    return jnp.zeros(rows.shape[1], rows.dtype)


def _number(x):
    return x.astype(jnp.float32)


def _first_maximum(scores):
    number = jax.lax.iota(jnp.int32, scores.shape[0])
    return jnp.min(jnp.where(scores == jnp.max(scores), number, scores.shape[0] - 1))


class Found(NamedTuple):
    """A plan, and what the search found of the actions of the root, in the order of their addition."""

    path: Any
    children: Any
    visits: Any
    means: Any


def by_engine(run, key, start) -> Found:
    """The plan by the engine, as `planner.plan` finds it."""
    tree, memory = run.planner.search(key, run.problem, start)
    children = tree.children[ROOT]
    path = run.planner.path_of(memory, run.planner.recommend(tree, memory))
    return Found(path, children, tree.totals_of(children)[:, 0], tree.mean_return(children))


def begin(run, key) -> tuple:
    """The candidates, their paths, and the indices that a search draws."""
    memory, draws = run.planner.begin(jax.random.split(key)[0], jnp.float32)
    return memory.candidates, memory.paths, draws.rollout, draws.initial


def by_kernel(run, search: Search, key, start, warps: int) -> Found:
    """The plan by the kernel."""
    candidates, paths, rollout, initial = begin(run, key)
    number, samples, _ = paths.shape
    more, actions = _power_of_two(number) - number, _power_of_two(run.planner.num_actions)
    padded = jnp.pad(paths, ((0, more), (0, _power_of_two(samples) - samples), (0, 0)), mode="edge")
    given = Given(
        start, jnp.pad(candidates, ((0, more), (0, 0))).T, jnp.moveaxis(padded, 2, 0), rollout, initial
    )
    rows = search.iterations + 1
    shapes = [(rows, actions), (rows,), (rows,), (rows, NUM_COLUMNS), (rows, actions), (rows, number + more)]
    dtypes = [jnp.int32] * 3 + [jnp.float32] * 3
    results = [jax.ShapeDtypeStruct(*each) for each in zip(shapes, dtypes, strict=True)]

    def kernel(*refs):
        search(Given(*refs[: len(given)]), Tree(*refs[len(given) :]))

    tree = Tree(*launch(kernel, results, *given, name="kcbts_plan", warps=warps))
    children = tree.children[ROOT, : run.planner.num_actions]
    exists = children != UNVISITED
    visits = jnp.where(exists, tree.numbers[children, VISITS], 0.0)
    means = jnp.where(exists, tree.numbers[children, RETURN] / jnp.maximum(visits, 1.0), -jnp.inf)
    path = paths[tree.candidate[children[jnp.argmax(means)]]]
    return Found(path, children, visits, means)


def _power_of_two(number: int) -> int:
    return 1 << (number - 1).bit_length()


def compare(engine: Found, kernel: Found) -> None:
    """Print how many plans of the kernel are those of the engine."""
    a, b = jax.tree.map(np.asarray, (engine, kernel))
    runs = len(a.path)
    assert len(np.unique(b.path.reshape(runs, -1), axis=0)) == runs, "two runs gave the same result"
    error = np.where((a.children != UNVISITED) & (b.children != UNVISITED), 1.0, 0.0)
    error *= np.abs(np.nan_to_num(a.means) - np.nan_to_num(b.means)) / np.maximum(1.0, np.abs(a.means))
    error = np.nan_to_num(error).max(axis=1)
    same = {
        "children": (a.children == b.children).all(axis=1),
        "visits": (a.visits == b.visits).all(axis=1),
        "action": np.abs(a.path - b.path).max(axis=(1, 2)) < 1e-4,
        "means within 1e-4": error < 1e-4,
    }
    same["everything"] = np.logical_and.reduce(list(same.values()))
    counts = ", ".join(f"{name} {np.sum(equal)}" for name, equal in same.items())
    best = [np.mean(np.max(each.means, axis=1)) for each in (a, b)]
    print(f"    equal to the engine, of {runs} plans: {counts}")
    print(f"    relative difference of means: median {np.median(error):.1e}, largest {error.max():.1e}")
    print(f"    highest mean return, mean of the runs: engine {best[0]:.3f}, kernel {best[1]:.3f}")


def main() -> None:
    """Compare the results and the times."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, nargs="+", default=[200, 1000], help="runs at once (200 1000)")
    parser.add_argument("--iterations", type=int, default=300, help="iterations of a plan (300)")
    parser.add_argument("--warps", type=int, nargs="+", default=[4, 8], help="warps of a lane (4 8)")
    parser.add_argument("--rows", type=int, default=8, help="children whose rows are read at once (8)")
    parser.add_argument("--repeats", type=int, default=7, help="repeats, of which the median is printed (7)")
    args = parser.parse_args()
    run: Any = build(Planning(dtype="float32", planner=KCBTS(iterations=args.iterations)), "float32")
    search = Search(run, args.rows)

    def prepare(index):
        starts, keys = jax.random.split(jax.random.key(0))
        return jax.random.fold_in(keys, index), run.problem.reset(jax.random.fold_in(starts, index))

    def program(function):
        return eqx.filter_jit(jax.vmap(function, axis_name=LANES))

    programs = {"begin": program(lambda key, start: begin(run, key))}
    programs["engine"] = program(lambda key, start: by_engine(run, key, start))
    for warps in args.warps:
        programs[f"kernel, {warps} warps"] = program(
            lambda key, start, warps=warps: by_kernel(run, search, key, start, warps)
        )
    for runs in args.runs:
        given = jax.block_until_ready(jax.vmap(prepare)(jnp.arange(runs, dtype=jnp.int32)))
        results, seconds = {}, {}
        for name, function in programs.items():
            start = time.perf_counter()
            results[name] = jax.block_until_ready(function(*given))
            print(f"{runs} runs, {name}: first call {time.perf_counter() - start:.1f} s", flush=True)
            if on_gpu():
                seconds[name] = median_seconds(lambda f=function, g=given: f(*g), args.repeats)
                rate = runs * args.iterations / seconds[name]
                print(
                    f"    {seconds[name]:.5f} s" + (f", {rate:,.0f} iterations/s" if name != "begin" else "")
                )
            if name.startswith("kernel"):
                if on_gpu():
                    alone = [seconds[each] - seconds["begin"] for each in ("engine", name)]
                    ratio, ratio_alone = seconds["engine"] / seconds[name], alone[0] / alone[1]
                    print(f"    x{ratio:.1f} of the engine; without `begin` in both, x{ratio_alone:.1f}")
                compare(results["engine"], results[name])


if __name__ == "__main__":
    main()
