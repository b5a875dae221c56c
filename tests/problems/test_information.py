"""The objectives `information` and `entropy` pay what a refit with the samples takes from the belief."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

import bojax
from bojax.problems.field_problem import PLACES
from bojax.problems.objectives import EntropyObjective, InformationObjective
from tests.planning.samples import OBJECTIVES, f64, field_belief, monitoring
from tests.problems.test_monitoring import SIZE, drives

INFORMATION = InformationObjective()
PROBLEM = dataclasses.replace(monitoring(), objective=INFORMATION)
POSE = (0.5, 1.2, 0.5)


def kernel(first, second):
    """The kernel of `monitoring`: variance 0.8, lengthscale 0.6."""
    squared = np.sum((first[:, None] - second[None]) ** 2, axis=-1)
    return 0.8 * np.exp(-0.5 * squared / 0.6**2)


def mean_variance(x):
    """Mean posterior variance over the free points of the domain after samples at `x`."""
    grid = PROBLEM.arena.grid(PLACES)
    points = np.asarray(grid)[np.asarray(PROBLEM.arena.is_free(grid))]
    gram = kernel(x, x) + 0.01 * np.eye(len(x))
    return float(
        np.mean(0.8 - np.sum(kernel(points, x) * np.linalg.solve(gram, kernel(x, points)).T, axis=1))
    )


def entropy(x):
    """Entropy in nats that samples at `x` take from the field: half the log determinant of I + K / noise."""
    return 0.5 * np.linalg.slogdet(np.eye(len(x)) + kernel(x, x) / 0.01)[1]


def driven(paths):
    """The samples of paths driven one after the other, and whether each is taken."""
    pose, found = f64(POSE), []
    for path in paths:
        drive, pose, _ = followed(PROBLEM.arena, pose, f64(path))
        found.append(np.asarray(drive.poses[:, :2])[np.asarray(drive.is_driven)])
    return found


@eqx.filter_jit
def followed(arena, pose, path):
    """A drive along a path, its end and its cost."""
    drive = arena.drive(pose, path)
    return drive, arena.end(drive), arena.cost(drive)


@eqx.filter_jit
def simulated(problem, belief, paths, depth=None):
    """The rewards of paths imagined one after the other."""
    root, node = problem.root(belief, depth or len(paths))
    return problem.simulate(jax.random.key(0), root, node, paths, None).rewards


@pytest.mark.parametrize(
    "objective, left", [(INFORMATION, mean_variance), (EntropyObjective(), lambda x: -entropy(x))]
)
def test_rewards_are_what_a_refit_with_the_samples_reduces_and_the_world_pays_them(objective, left):
    problem = dataclasses.replace(PROBLEM, objective=objective)
    belief = field_belief(problem, POSE, 5)
    x = np.asarray(belief.posterior.x)[:5]
    _, paths = drives(3, seed=4)
    costs = []
    expected, pose = [], f64(POSE)
    for samples, path in zip(driven(paths), paths, strict=True):
        before = left(x)
        x = np.concatenate([x, samples])
        expected.append(before - left(x))
        _, pose, cost = followed(PROBLEM.arena, pose, f64(path))
        costs.append(float(cost))
    found = np.asarray(simulated(problem, belief, f64(paths)))
    np.testing.assert_allclose(found - costs, expected, atol=1e-9)
    assert min(expected) > 0.0
    # The world pays the same for the first path.
    world = eqx.filter_jit(dataclasses.replace(problem, start=f64(POSE)).reset)(jax.random.key(0))
    _, _, events = jax.jit(type(problem).execute)(problem, jax.random.key(1), world, f64(paths[0]))
    paid = eqx.filter_jit(problem.reward)(None, belief, f64(paths[0]), events)
    assert float(paid) == pytest.approx(found[0], abs=1e-12)


def test_a_planner_may_plan_for_information_in_another_task():
    problem = monitoring()
    belief = field_belief(problem, POSE, 5)
    _, paths = drives(1, seed=1)
    root, node = problem.with_objective(INFORMATION).root(belief, 2)
    found = eqx.filter_jit(problem.simulate)(jax.random.key(0), root, node, f64(paths), INFORMATION).rewards
    np.testing.assert_array_equal(found, simulated(PROBLEM, belief, f64(paths), depth=2))
    assert problem.with_objective(None) is problem
    assert problem.with_objective(OBJECTIVES["value"]).root(belief, 2)[0].places is None


@pytest.mark.parametrize("kind", ["hilly-terrain", "indoor-props"])
def test_an_objective_is_exchanged_inside_of_a_compiled_plan(kind):
    """The checks of the constructor, such as that of the altitude, are not run on traced numbers."""
    problem = bojax.part(kind)

    @jax.jit
    def exchanged(problem):
        return problem.with_objective(INFORMATION)

    assert exchanged(problem).objective == INFORMATION
    assert problem.objective != INFORMATION


def test_a_sample_beside_another_explains_little():
    belief = field_belief(PROBLEM, POSE, 0)
    straight = np.stack([np.linspace(0.1, 0.6, SIZE), np.zeros(SIZE), np.zeros(SIZE)], axis=1)
    crowded = np.repeat(straight[:1], SIZE, axis=0)
    wide, narrow = (float(simulated(PROBLEM, belief, f64(path[None]))[0]) for path in (straight, crowded))
    assert narrow < 0.7 * wide
