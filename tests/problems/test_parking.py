"""Robot parking against (4.13) written pose by pose, in every setting that the thesis leaves open."""

import itertools
from collections import Counter
from math import pi

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.motions.base import place
from bojax.problems.parking import RULES
from tests.motions.families import FAMILIES, all_paths
from tests.planning.samples import parking
from tests.reference.parking import Parking as ParkingReference

D_MAX = 2.0**0.5 * 4.0

CHOICES = {
    "bearing": ("world", "robot"),
    "rule": RULES,
    "exit_terminates": (False, True),
}


outcomes = jax.jit(lambda problem, starts, paths: jax.vmap(problem.outcome)(starts, paths))


def outcome(pose, **settings):
    """What a path of one pose leads to."""
    path = jnp.asarray([[pose]], jnp.float64)
    problem = parking(**{"distance_tolerance": 0.1} | settings)
    return jax.tree.map(lambda v: v[0].item(), outcomes(problem, jnp.zeros((1, 3)), path))


def driven_paths() -> tuple[np.ndarray, np.ndarray]:
    """Starts and paths: kernel trajectories from anywhere, towards the lot, and near the border."""
    rng = np.random.default_rng(0)
    library = all_paths(FAMILIES["kernel"])
    anywhere = rng.uniform([-4.0, -4.0, 0.0], [4.0, 4.0, 2.0 * pi], (300, 3))
    heading = rng.choice([0.0, pi], 600) + rng.normal(scale=0.3, size=600)
    back = rng.uniform(0.2, 1.1, 600)
    near = np.stack([-back * np.cos(heading), -back * np.sin(heading), heading], axis=-1)
    near[:, :2] += rng.normal(scale=0.05, size=(600, 2))
    border = anywhere[:150] * [0.25, 1.0, 1.0] + [3.2, 0.0, 0.0]  # some of them outside
    starts = np.concatenate([anywhere, near, border])
    own = library[rng.integers(len(library), size=len(starts))]
    return starts, np.asarray(jax.vmap(place)(jnp.asarray(own), jnp.asarray(starts)))


def jumping_paths() -> tuple[np.ndarray, np.ndarray]:
    """Poses without a path between them: leaving, returning and parking all happen to one path."""
    rng = np.random.default_rng(1)
    paths = rng.uniform([-4.4, -4.4, 0.0], [4.4, 4.4, 2.0 * pi], (500, 8, 3))
    at_the_lot = rng.uniform([-0.11, -0.11, -0.4], [0.11, 0.11, 0.4], paths.shape)
    paths = np.where(rng.uniform(size=(500, 8, 1)) < 0.15, at_the_lot, paths)
    inside = np.clip(paths, -4.0, 4.0)
    return rng.uniform(-4.4, 4.4, (500, 3)), np.where(rng.uniform(size=(500, 1, 1)) < 0.5, inside, paths)


@pytest.mark.parametrize("choices", [*itertools.product(*CHOICES.values())], ids=str)
def test_outcomes_are_those_of_the_reward_written_pose_by_pose(choices):
    settings = dict(zip(CHOICES, choices, strict=True)) | {"distance_tolerance": 0.1}
    starts, paths = (np.concatenate(both) for both in zip(driven_paths(), jumping_paths(), strict=True))
    found = outcomes(parking(**settings), jnp.asarray(starts), jnp.asarray(paths))
    reference = ParkingReference(**settings)
    expected = [reference.outcome(*each) for each in zip(starts, paths, strict=True)]
    np.testing.assert_allclose(found.reward, [result.reward for result in expected], atol=1e-12)
    for field in ("terminated", "success", "exited", "last"):
        np.testing.assert_array_equal(getattr(found, field), [getattr(result, field) for result in expected])
    reached = Counter(result.branch for result in expected)
    assert min(reached[name] for name in ("off axis", "off heading", "on axis", "exit", "parked")) >= 5


def test_problems_that_differ_in_the_rule_share_a_program():
    shapes = {jax.tree.structure(parking(rule=rule)) for rule in RULES}
    assert len(shapes) == 1
    poses = ([-0.05, 0.0, 0.0], [0.0, 0.05, 0.0])  # on the axis of the spot, and beside it
    parked = {rule: [outcome(pose, rule=rule).success for pose in poses] for rule in RULES}
    assert parked["printed"] == parked["anywhere"] == [True, False]
    assert parked["bearing-dropped"] == parked["anywhere-bearing-dropped"] == [True, True]


def test_the_three_levels_of_the_reward():
    off_axis, off_heading, on_axis = (
        outcome(pose).reward for pose in ([2.0, 2.0, 0.0], [2.0, 0.0, pi / 4], [2.0, 0.0, 0.0])
    )
    assert off_axis == pytest.approx(-np.sin(pi / 4) - D_MAX - 1.0)
    assert off_heading == pytest.approx(-np.sin(pi / 4) - D_MAX)
    assert on_axis == pytest.approx(-2.0)
    # Each level lies above all of the level before it.
    assert -D_MAX - 2.0 <= off_axis < -D_MAX - 1.0 <= off_heading < -D_MAX <= on_axis


def test_the_tolerances_and_the_border_count():
    assert outcome([0.125, 0.0, 0.0], distance_tolerance=0.125).success
    assert not outcome([0.125 + 1e-12, 0.0, 0.0], distance_tolerance=0.125).success
    assert outcome([0.0, 0.0, 0.0]).success
    assert outcome([0.0, 0.0, pi]).success  # the opposite heading has the same |sin alpha|
    assert not outcome([0.0, 0.0, pi / 2]).success
    assert not outcome([4.0, -4.0, 0.0]).exited
    assert outcome([4.0 + 1e-12, 0.0, 0.0]).exited


def test_starts_are_uniform_over_the_domain_and_all_headings():
    keys = jax.random.split(jax.random.key(0), 3000)
    poses = np.asarray(jax.jit(jax.vmap(parking(half_width=2.5).reset))(keys))
    for axis, (low, width) in enumerate([(-2.5, 5.0), (-2.5, 5.0), (0.0, 2.0 * pi)]):
        assert stats.kstest(poses[:, axis], "uniform", args=(low, width)).pvalue > 1e-3
    assert np.abs(stats.spearmanr(poses).statistic - np.eye(3)).max() < 0.06
