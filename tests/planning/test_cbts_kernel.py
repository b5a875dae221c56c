"""The kernel of CBTS, which a CPU interprets, grows the trees of the program of XLA."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.experiments.settings import Planning
from bojax.numerics.lanes import LANES
from bojax.planning import cbts, cbts_kernel
from bojax.planning.settings import KCBTS
from bojax.planning.tree import ROOT, UNVISITED
from bojax.problems.parking import Parking
from tests.arrays import f64
from tests.compiling import as_for_a_gpu
from tests.planning.samples import POSES, kcbts, monitoring, parking
from tests.planning.test_reference import EASY
from tests.tiers import by_tier

ERROR = 1e-12 if jax.default_backend() == "cpu" else 1e-9
"""A GPU adds numbers in another order."""

LANE_SETTINGS = [
    ({}, {"distance_tolerance": 0.6}, "before the lot"),
    ({"max_actions": 3, "discount": 0.8}, {"rule": "bearing-dropped", "distance_tolerance": 0.8}, "far"),
    ({"exploration": 500.0}, {"rule": "anywhere", "exit_terminates": False}, "at the border"),
    ({"convergence": 1.0, "max_actions": 20}, {"rule": "anywhere", "exit_reward": -30.0}, "in the corner"),
    ({"convergence": 0.5, "exploration": 0.0}, {"rule": EASY, "distance_tolerance": 1.0}, "beside the lot"),
]
"""Settings that lanes of one program differ in, of the planner and of the problem, and where they start."""

PROGRAMS = {
    "depth 3": ({"iterations": 40}, {}),
    "depth 2, ranks, variance, robot's bearing": (
        {"depth": 2, "scaling": "rank", "acquisition": "ucb, variance", "num_initial": 1, "iterations": 25},
        {"bearing": "robot"},
    ),
    "depth 4, unscaled": ({"depth": 4, "scaling": "none", "iterations": 25}, {}),
}
"""Settings that are parts of a program."""


@pytest.fixture
def kernels(monkeypatch):
    """No kernel is used until this is called; then it is wherever it can be, and counted how often."""
    used = []
    monkeypatch.setattr(cbts_kernel, "kernels_run_here", lambda: False)

    def kernel_of(is_kernel, by_kernel, by_xla, *args):
        used.append(is_kernel)
        return by_kernel(*args)

    def begin():
        monkeypatch.setattr(cbts_kernel, "kernels_run_here", lambda: True)
        monkeypatch.setattr(cbts, "either", kernel_of)
        return used

    return begin


@jax.jit
def stacked(modules):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *modules)


def search(planner, problem, key, pose):
    return planner.search(key, problem, pose)


by_xla = eqx.filter_jit(eqx.filter_vmap(search, axis_name=LANES))


def grown(planners, problems, search=by_xla):
    """The trees of all lanes, and what the planner remembers."""
    keys = jax.random.split(jax.random.key(0), len(LANE_SETTINGS))
    poses = f64([POSES[name] for *_, name in LANE_SETTINGS])
    return jax.device_get(search(planners, problems, keys, poses))


@pytest.mark.parametrize("name", by_tier(PROGRAMS, normal=["depth 3"]))
def test_trees_are_those_of_xla(name, kernels):
    settings, settings_of_problem = PROGRAMS[name]
    planners = stacked([kcbts(**{**settings, **own}) for own, *_ in LANE_SETTINGS])
    lengthscales = f64(np.linspace(0.3, 1.2, len(LANE_SETTINGS)))
    planners = eqx.tree_at(lambda planner: planner.kernel.lengthscale, planners, lengthscales)
    planners = eqx.tree_at(lambda planner: planner.acquisition.kappa, planners, 10.0 * lengthscales)
    planners = eqx.tree_at(lambda planner: planner.noise_variance, planners, 0.1 * lengthscales)
    problems = stacked([parking(**settings_of_problem, **own) for _, own, _ in LANE_SETTINGS])
    expected = grown(planners, problems)
    used = kernels()
    by_kernel = eqx.filter_jit(eqx.filter_vmap(lambda *given: search(*given), axis_name=LANES))
    found = grown(planners, problems, by_kernel)
    assert used == [True]
    for lane in range(len(LANE_SETTINGS)):
        (tree, memory), (got, remembered) = jax.tree.map(lambda x, lane=lane: x[lane], (expected, found))
        nodes = nodes_of(tree)
        pairs = [(getattr(got, f), getattr(tree, f)) for f in ("children", "totals", "outcome", "beliefs")]
        pairs += [
            (getattr(remembered, f), getattr(memory, f)) for f in ("actions", "whitened", "has_converged")
        ]
        for have, wanted in pairs:
            np.testing.assert_allclose(have[nodes], wanted[nodes], rtol=ERROR, atol=ERROR, err_msg=f"{lane}")


def test_the_kernel_is_lowered_for_a_gpu(kernels, monkeypatch):
    """Triton's program is made on any machine, and compiled on a GPU."""
    kernels()

    def search(key, pose):
        return kcbts(iterations=40).search(key, parking(), pose)

    keys = jax.random.split(jax.random.key(0), 2)
    with as_for_a_gpu(monkeypatch):
        traced = jax.jit(jax.vmap(search, axis_name=LANES)).trace(keys, jnp.zeros((2, 3)))
        assert "triton" in traced.lower(lowering_platforms=("cuda",)).as_text()


def test_the_lanes_differ_in_what_a_kernel_may_get_wrong():
    planners = stacked([kcbts(**{"iterations": 40, **own}) for own, *_ in LANE_SETTINGS])
    problems = stacked([parking(**own) for _, own, _ in LANE_SETTINGS])
    grown_in_lanes = grown(planners, problems)
    ends, sizes, converged = set(), [], 0
    for lane in range(len(LANE_SETTINGS)):
        tree, memory = jax.tree.map(lambda x, lane=lane: x[lane], grown_in_lanes)
        nodes = nodes_of(tree)
        ends |= set(tree.reward[nodes][tree.is_terminal[nodes]].tolist())
        sizes.append(len(nodes))
        converged += int(memory.has_converged[nodes].sum())
    assert ends == {1000.0, -30.0}  # parked, and outside
    assert min(sizes) < 20 < max(sizes) < 41  # some iterations add no node
    assert converged > 0


def nodes_of(tree):
    """All nodes of a tree, the root first."""
    nodes = [ROOT]
    for node in nodes:
        nodes += [int(child) for child in tree.children[node] if child != UNVISITED]
    return np.asarray(nodes)


def test_an_episode_is_the_same(kernels):
    experiment = build(Planning(planner=KCBTS(iterations=12, depth=2, num_candidates=16)), "float64")

    def driven():
        def episode(key):
            carry = experiment.init(key)
            carry, rows = jax.lax.scan(lambda carry, _: experiment.advance(carry), carry, length=3)
            return carry.record.paths[:3], rows

        keys = jax.random.split(jax.random.key(1), 2)
        return eqx.filter_jit(eqx.filter_vmap(episode, axis_name=LANES))(keys)

    expected, used = driven(), kernels()
    found = driven()
    assert used and all(used)
    for got, wanted in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=ERROR, atol=ERROR)


class Subclass(cbts.ContinuousBeliefTreeSearch):
    """A search that may choose actions in another way."""


class OtherParking(Parking):
    """A problem that may have another outcome."""


class DeclaredParking(OtherParking):
    """A problem that says that its outcome can be computed in a kernel."""

    runs_in_kernels = True


class WalledParking(OtherParking):
    """A problem that says so although its outcome depends on an array."""

    runs_in_kernels = True

    walls: jax.Array


def test_other_searches_are_programs_of_xla(kernels):
    planner, problem = kcbts(), parking()
    assert not cbts_kernel.is_used(planner, problem)
    used = kernels()
    assert cbts_kernel.is_used(planner, problem)
    for other in (kcbts("log-ei"), kcbts(refine_steps=2), kcbts(depth=1), kcbts(depth=7)):
        assert not cbts_kernel.is_used(other, problem)
    assert not cbts_kernel.is_used(planner, monitoring())
    assert not cbts_kernel.is_used(planner, remade(OtherParking, problem))
    assert cbts_kernel.is_used(planner, remade(DeclaredParking, problem))
    walled = WalledParking(**vars(problem), walls=jnp.zeros(2))  # a kernel has no arrays of the problem
    assert not cbts_kernel.is_used(planner, walled)
    other, key = remade(Subclass, planner), jax.random.key(0)
    eqx.filter_eval_shape(other.search, key, problem, f64(POSES["far"]))
    assert used == []


def remade(cls, module):
    """A module of a subclass with the same fields."""
    return cls(**{field.name: getattr(module, field.name) for field in dataclasses.fields(module)})
