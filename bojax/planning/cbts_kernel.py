"""The search of CBTS (Algorithms 3 and 4) as one kernel, for problems whose outcome a kernel can compute.

As a program of XLA, an iteration of the search is some 33 kernels, each of which waits for the one before.
Here a lane is one program of a kernel, with the loop over the iterations inside, which reads and writes the
tree in the memory of the GPU. What depends on no reward is computed before: the random numbers, the paths of
the candidates and their covariances. The kernel calls the planner and the problem of its lane, as the program
of XLA does. Both find the same tree, unless rounding decides between two actions.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bojax.acquisition.functions import UpperConfidenceBound
from bojax.motions.base import Poses, placed
from bojax.numerics.linalg import noise_floor
from bojax.numerics.pallas import barrier, imported, kernels_run_here, launch, power_of_two
from bojax.planning.search import return_of
from bojax.planning.tree import ROOT, UNVISITED, Tree, upper_bound
from bojax.problems.path_problem import PathProblem
from bojax.problems.pose import PoseProblem

WARPS = 1
"""Warps of a lane.

On an H200, 200 plans in float64 take 3.6 ms with one warp and 4.5 with two, and 1,000 take 6.1 and 7.2.
"""

ENTRIES = {4: 1024, 8: 256}
"""How many whitened covariances a lane reads at once, by the size of a number in bytes."""

X, Y, HEADING, REWARD, IS_OVER, VISITS, RETURN, HAS_CONVERGED, IS_FULL, PARAMS = map(np.int32, range(10))
"""Columns of `Rows.numbers`. All indices are explicitly 32-bit: in JAX's 64-bit mode, others are 64-bit."""

POSE = X, Y, HEADING


def is_used(planner: Any, problem: PathProblem) -> bool:
    """Whether the search of a `ContinuousBeliefTreeSearch` is a kernel; its sizes bound that program."""
    return (
        kernels_run_here()
        and isinstance(problem, PoseProblem)
        and vars(type(problem)).get("runs_in_kernels", False)
        and all(jnp.ndim(value) == 0 for value in vars(problem).values() if eqx.is_array(value))
        and type(planner.acquisition) is UpperConfidenceBound
        and planner.refine_steps == 0
        and 2 <= planner.depth <= 6
        and planner.num_candidates <= 256
        and planner.num_actions <= 64
        and planner.motions.num_samples <= 64
    )


class Given(NamedTuple):
    """What the search of a lane reads."""

    start: Any  # pose of the root, [3]
    max_actions: Any  # number of actions of a node, []
    candidates: Any  # parameters of the candidates, [D, C]
    prior: Any  # their prior variances, [C]
    covariances: Any  # their prior covariances, [C, C]
    paths: Any  # x, y and heading of their paths, [3, C, S]
    rollout: Any  # candidates that the rollouts follow, [I, H - 1]
    initial: Any  # candidates that nodes with few actions try, [I]


class Rows(NamedTuple):
    """The tree of a lane, and its models: a node and the action that leads to it have one row."""

    children: Any  # children of each node in the order of their addition, or `UNVISITED`, [N, A]
    parent: Any  # [N]
    numbers: Any  # the columns above, and from `PARAMS` on the parameters of the action, [N, K]
    factor: Any  # row of the action in the inverse Cholesky factor of its node, [N, A]
    whitened: Any  # row of the action in the whitened covariances of the candidates, [N, C]


def search(
    planner: Any, problem: Any, start: Float[Array, "3"], memory: Any, draws: Any
) -> tuple[Tree, dict[str, Array]]:
    """The tree after all iterations, and the fields of `memory`, a `NodeModels`, that have changed."""
    number, num_actions, num_params = planner.num_candidates, planner.num_actions, planner.motions.num_params
    (_, samples, _), dtype = memory.paths.shape, memory.paths.dtype
    # Arrays of a kernel have powers of two as sizes. Further poses repeat the first of a path, so that the
    # last one remains the last.
    more, actions = power_of_two(number) - number, power_of_two(num_actions)
    paths = jnp.pad(memory.paths, ((0, more), (power_of_two(samples) - samples, 0), (0, 0)), mode="edge")
    covariances = planner.kernel.gram(memory.candidates, memory.candidates)
    given = Given(
        start=start,
        max_actions=jnp.sum(planner.max_actions, dtype=jnp.int32),
        candidates=jnp.pad(memory.candidates, ((0, more), (0, 0))).T,
        prior=jnp.pad(jnp.diagonal(covariances), (0, more)),
        covariances=jnp.pad(covariances, ((0, more), (0, more))),
        paths=jnp.moveaxis(paths, 2, 0),
        rollout=draws.rollout.astype(jnp.int32),
        initial=draws.untried.astype(jnp.int32),
    )

    def rows_of(dtype: Any, *width: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((planner.iterations + 1, *width), dtype)

    results = Rows(
        children=rows_of(jnp.int32, actions),
        parent=rows_of(jnp.int32),
        numbers=rows_of(dtype, int(PARAMS) + num_params),
        factor=rows_of(dtype, actions),
        whitened=rows_of(dtype, number + more),
    )
    numbers, rebuilt = _numbers_of((planner, problem))

    def kernel(*refs: Any) -> None:
        first, last = len(numbers), len(refs) - len(results)
        planner, problem = rebuilt([ref[...] for ref in refs[:first]])
        _Search(planner, problem, Given(*refs[first:last]), Rows(*refs[last:])).run()

    rows = Rows(*launch(kernel, results, *numbers, *given, name="cbts", warps=WARPS))
    tree = Tree(
        beliefs=rows.numbers[:, :REWARD],
        outcome=rows.numbers[:, REWARD:VISITS],
        totals=rows.numbers[:, VISITS:HAS_CONVERGED],
        children=rows.children[:, :num_actions],
        branches=None,
        parameters=None,
    )
    actions = jnp.concatenate([rows.numbers[:, PARAMS:], rows.factor[:, :num_actions]], axis=1)
    has_converged = rows.numbers[:, HAS_CONVERGED] > 0.0
    return tree, dict(actions=actions, whitened=rows.whitened[:, :number], has_converged=has_converged)


class _Search(NamedTuple):
    """The search of a lane, on references to the memory of the GPU."""

    planner: Any  # a `ContinuousBeliefTreeSearch`
    problem: Any  # a `PoseProblem`
    given: Given
    rows: Rows

    def run(self) -> None:
        """All iterations."""
        self.rows.children[ROOT, :] = jnp.zeros(self.rows.children.shape[1], jnp.int32)
        self.rows.factor[ROOT, :] = self._zeros(self.rows.factor.shape[1])
        self.rows.whitened[ROOT, :] = self._zeros(self.rows.whitened.shape[1])
        self._write(np.int32(ROOT), *(self.given.start[column] for column in POSE))

        def iterate(i: Any, carry: Any) -> Any:
            barrier()  # until the tree has been written
            node, level = self.descend()
            is_new = (level < self.planner.depth) & (self.rows.numbers[node, IS_OVER] == 0.0)
            jax.lax.cond(
                is_new,
                lambda: self.expand(i, node, level),
                lambda: self.back_up(node, self._zeros()),
            )
            return carry

        jax.lax.fori_loop(np.int32(0), np.int32(self.planner.iterations), iterate, np.int32(0))

    def descend(self) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """The node where the search tries a new action, and its level (`TreePolicy`)."""

        def body(carry: Any) -> Any:
            node, level, _ = carry
            child = self.best_child(node)
            return child, level + np.int32(1), self.rows.numbers[child, IS_FULL]

        first = jnp.int32(ROOT), jnp.int32(0), self.rows.numbers[np.int32(ROOT), IS_FULL]
        node, level, _ = jax.lax.while_loop(lambda carry: carry[2] > 0.0, body, first)
        return node, level

    def best_child(self, node: Int[Array, ""]) -> Int[Array, ""]:
        """The child of highest upper bound (4.1)."""
        children = self.rows.children[node, :]
        exists = children != UNVISITED
        visits = jnp.where(exists, self.rows.numbers[children, VISITS], 0.0)
        at_node, returns = self.rows.numbers[node, VISITS], self.rows.numbers[children, RETURN]
        bounds = upper_bound(visits, returns, at_node, self.planner.exploration)
        return self.rows.children[node, _first_maximum(bounds)]

    def expand(self, i: Int[Array, ""], node: Int[Array, ""], level: Int[Array, ""]) -> None:
        """Add a child, with the rewards of its action and of a rollout from there, and back up."""
        planner, numbers = self.planner, self.rows.numbers
        candidate, place, rows, has_converged = self.propose(i, node)
        # Line 12 of Algorithm 4, with the new child among the children.
        is_full = (place + np.int32(1) >= self.given.max_actions[...]) | has_converged
        rollout = [self.given.rollout[i, np.int32(step)] for step in range(planner.depth - 1)]
        poses, outcomes = [Poses([numbers[node, column] for column in POSE])], []
        for each in [candidate, *rollout]:
            path = self.path(each, poses[-1])
            outcomes.append(self.problem.outcome(poses[-1], path))
            poses.append(path[-1])
        rewards, ends = [each.reward for each in outcomes], [each.terminated for each in outcomes]
        future = return_of(rewards, ends, np.int32(planner.depth) - level, planner.discount)
        child = i + np.int32(1)
        self.rows.children[child, :] = jnp.zeros(self.rows.children.shape[1], jnp.int32)
        self.rows.parent[child] = node
        self.rows.factor[child, :], self.rows.whitened[child, :] = rows
        found = rewards[0], ends[0], 1.0, future, has_converged, False
        self._write(child, *(poses[1][column] for column in POSE), *found, *self._params(candidate))
        self.back_up(node, future)
        self.rows.children[node, place], numbers[node, IS_FULL] = child, self._number(is_full)

    def propose(
        self, i: Int[Array, ""], node: Int[Array, ""]
    ) -> tuple[Int[Array, ""], Int[Array, ""], tuple[Array, Array], Bool[Array, ""]]:
        """The candidate to try, its place, its rows in the node's model, and whether the node converges."""
        planner, given, whitened = self.planner, self.given, self.rows.whitened
        children = self.rows.children[node, :]
        exists, (actions, width) = children != UNVISITED, (children.shape[0], whitened.shape[1])
        count = jnp.sum(exists, dtype=jnp.int32)
        rewards = planner.scaled(self.rows.numbers[children, REWARD], exists)
        y, best = jnp.where(exists, rewards, 0.0), jnp.max(jnp.where(exists, rewards, -jnp.inf))

        def explain(known: Array) -> tuple[Array, Array]:
            rows = whitened[known, :]
            residuals = jnp.sum(self.rows.factor[known, :] * y[None, :], axis=1)
            return residuals[:, None] * rows, rows * rows

        def project(known: Array) -> tuple[Array, Array]:
            own = whitened[known, candidate][:, None]
            return own * whitened[known, :], own * self.rows.factor[known, :]

        # Line 3 of Algorithm 3: the candidate of highest acquisition (4.2).
        mean, explained = self._over_children(node, count, explain, (width, width))
        std = jnp.sqrt(jnp.maximum(given.prior[:] - explained, 0.0))
        is_candidate = jnp.arange(width, dtype=jnp.int32) < np.int32(planner.num_candidates)
        scores = jnp.where(is_candidate, planner.acquisition(mean, std, best), -jnp.inf)
        candidate = jnp.where(count < planner.num_initial, given.initial[i], _first_maximum(scores))

        # What the action appends to the model (`GaussianProcess.next_row` and `next_whitened`).
        own, prior = whitened[children, candidate], given.prior[candidate]
        noise = jnp.maximum(planner.noise_variance, noise_floor(prior.dtype) * prior)
        pivot = jnp.sqrt(jnp.maximum(prior + noise - jnp.sum(own * own), noise))
        shared, row = self._over_children(node, count, project, (width, actions))
        row = jnp.where(jnp.arange(actions, dtype=jnp.int32) == count, 1.0, -row) / pivot
        next_whitened = (given.covariances[candidate, :] - shared) / pivot

        previous, squares = jnp.max(children), self._zeros()  # a later node has a higher index
        for d, param in enumerate(self._params(candidate)):
            squares = squares + (param - self.rows.numbers[previous, PARAMS + np.int32(d)]) ** 2
        has_converged = (count > 0) & (jnp.sqrt(squares) < planner.convergence)
        return candidate, count, (row, next_whitened), has_converged

    def path(self, candidate: Int[Array, ""], pose: Poses) -> Poses:
        """The path of a candidate from a pose, in the world frame."""
        paths = self.given.paths
        last = np.int32(paths.shape[2] - 1)
        samples = Poses([paths[column, candidate, :] for column in POSE])
        end = Poses([paths[column, candidate, last] for column in POSE])
        return Poses(placed(samples, pose), Poses(placed(end, pose)))

    def back_up(self, node: Int[Array, ""], future: Float[Array, ""]) -> None:
        """Credit the actions from `node` to the root with their rewards and the return after them."""
        barrier()  # until nothing reads the rows of earlier nodes
        numbers = self.rows.numbers

        def credit(node: Any, gain: Any) -> None:
            numbers[node, VISITS] = numbers[node, VISITS] + 1.0
            numbers[node, RETURN] = numbers[node, RETURN] + gain

        def body(carry: Any) -> Any:
            node, gain = carry
            gain = numbers[node, REWARD] + self.planner.discount * gain
            credit(node, gain)
            return self.rows.parent[node], gain

        _, gain = jax.lax.while_loop(lambda carry: carry[0] != ROOT, body, (node, future))
        credit(np.int32(ROOT), gain)

    def _over_children(
        self, node: Any, count: Any, of: Callable[[Array], tuple[Array, ...]], widths: tuple[int, ...]
    ) -> Sequence[Array]:
        """Sums over the children of a node; `of` computes the terms of a few at once, [K, width]."""
        pallas, _ = imported()
        entries = ENTRIES[self.rows.whitened.dtype.itemsize]
        size = min(max(entries // self.rows.whitened.shape[1], 1), self.rows.children.shape[1])

        # The rows of a missing child are those of the root, which are zero.
        def body(block: Any, sums: Any) -> Any:
            terms = of(self.rows.children[node, pallas.ds(block * np.int32(size), size)])
            return tuple(total + term for total, term in zip(sums, terms, strict=True))

        number = jax.lax.div(count + np.int32(size - 1), np.int32(size))
        zeros = tuple(self._zeros(size, width) for width in widths)
        return [jnp.sum(each, axis=0) for each in jax.lax.fori_loop(np.int32(0), number, body, zeros)]

    def _params(self, candidate: Int[Array, ""]) -> list[Float[Array, ""]]:
        candidates = self.given.candidates
        return [candidates[np.int32(d), candidate] for d in range(candidates.shape[0])]

    def _write(self, node: Any, *numbers: Any) -> None:
        """Write the columns of a node; those without a number are 0."""
        for column in range(self.rows.numbers.shape[1]):
            number = self._number(numbers[column] if column < len(numbers) else 0.0)
            self.rows.numbers[node, np.int32(column)] = number

    def _zeros(self, *shape: int) -> Float[Array, "..."]:
        return jnp.zeros(shape, self.rows.numbers.dtype)

    def _number(self, x: Any) -> Float[Array, ""]:
        return jnp.asarray(x, self.rows.numbers.dtype)


def _numbers_of(tree: Any) -> tuple[list[Array], Callable[[Sequence[Array]], Any]]:
    """The numbers in a tree of modules, and a function from these to the tree, without its other arrays."""
    numbers, rest = eqx.partition(tree, lambda leaf: eqx.is_array(leaf) and leaf.ndim == 0)
    rest = eqx.filter(rest, eqx.is_array, inverse=True)
    leaves, structure = jax.tree.flatten(numbers)
    return leaves, lambda given: eqx.combine(jax.tree.unflatten(structure, given), rest)


def _first_maximum(scores: Float[Array, "K"]) -> Int[Array, ""]:
    return jax.lax.argmax(scores, 0, jnp.int32)
