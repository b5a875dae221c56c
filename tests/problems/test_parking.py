"""Robot parking against (4.13) written pose by pose, in every setting that the thesis leaves open."""

import dataclasses
import itertools
from collections import Counter
from math import pi

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.motions.base import place
from bojax.problems.parking import Parking
from tests.motions.families import FAMILIES, all_paths
from tests.problems import parking_reference as reference

DEFAULT = reference.Settings()
D_MAX = 2.0**0.5 * 4.0

SETTINGS = [
    reference.Settings(
        bearing=bearing,
        success_needs_bearing=needs_bearing,
        exit_terminates=terminates,
        park_along_path=along,
    )
    for bearing, needs_bearing, terminates, along in itertools.product(
        ("world", "robot"), (False, True), (False, True), (False, True)
    )
]


def parking(settings: reference.Settings = DEFAULT, position_noise=0.02, heading_noise=0.03) -> Parking:
    values = dataclasses.asdict(settings)
    numbers = {name: jnp.asarray(v, jnp.float64) for name, v in values.items() if isinstance(v, float)}
    choices = {name: v for name, v in values.items() if not isinstance(v, float)}
    return Parking(
        **numbers,
        **choices,
        position_noise=jnp.asarray(position_noise, jnp.float64),
        heading_noise=jnp.asarray(heading_noise, jnp.float64),
        max_steps=15,
    )


outcomes = jax.jit(lambda problem, starts, paths: jax.vmap(problem.outcome)(starts, paths))


def outcome(settings: reference.Settings, path, start=(0.0, 0.0, 0.0)):
    """What one path leads to."""
    path = jnp.asarray(path, jnp.float64)
    return jax.tree.map(lambda v: v[0].item(), outcomes(parking(settings), jnp.asarray([start]), path[None]))


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


def describe(settings: reference.Settings) -> str:
    return "-".join(
        [settings.bearing]
        + ["needs-bearing"] * settings.success_needs_bearing
        + ["exit-ends"] * settings.exit_terminates
        + ["along-path"] * settings.park_along_path
    )


@pytest.mark.parametrize("settings", SETTINGS, ids=describe)
def test_outcomes_are_those_of_the_reward_written_pose_by_pose(settings):
    starts, paths = (np.concatenate(both) for both in zip(driven_paths(), jumping_paths(), strict=True))
    found = outcomes(parking(settings), jnp.asarray(starts), jnp.asarray(paths))
    expected = [reference.outcome(*each, settings) for each in zip(starts, paths, strict=True)]
    np.testing.assert_allclose(found.reward, [result.reward for result in expected], atol=1e-12)
    for field in ("terminated", "success", "exited", "last"):
        np.testing.assert_array_equal(getattr(found, field), [getattr(result, field) for result in expected])
    reached = Counter(result.branch for result in expected)
    assert min(reached[name] for name in ("off axis", "off heading", "on axis", "exit", "parked")) >= 5


def test_both_frames_of_the_bearing_matter():
    starts, paths = driven_paths()
    rewards = [
        outcomes(parking(dataclasses.replace(DEFAULT, bearing=b)), jnp.asarray(starts), jnp.asarray(paths))
        for b in ("world", "robot")
    ]
    assert np.mean(np.asarray(rewards[0].reward) != np.asarray(rewards[1].reward)) > 0.3


def test_the_three_levels_of_the_reward():
    off_axis = outcome(DEFAULT, [[2.0, 2.0, 0.0]])
    off_heading = outcome(DEFAULT, [[2.0, 0.0, pi / 4]])
    on_axis = outcome(DEFAULT, [[2.0, 0.0, 0.0]])
    assert off_axis.reward == pytest.approx(-np.sin(pi / 4) - D_MAX - 1.0)
    assert off_heading.reward == pytest.approx(-np.sin(pi / 4) - D_MAX)
    assert on_axis.reward == pytest.approx(-2.0)
    # Each level lies above all of the level before it.
    assert -D_MAX - 2.0 <= off_axis.reward < -D_MAX - 1.0 <= off_heading.reward < -D_MAX <= on_axis.reward


def test_parking_at_the_tolerances_counts():
    settings = dataclasses.replace(DEFAULT, distance_tolerance=0.125)
    assert outcome(settings, [[0.125, 0.0, 0.0]]).success
    assert not outcome(settings, [[0.125 + 1e-12, 0.0, 0.0]]).success
    assert outcome(settings, [[0.0, 0.0, 0.0]]).success
    assert outcome(settings, [[0.0, 0.0, pi]]).success  # the opposite heading has the same |sin alpha|
    assert not outcome(settings, [[0.0, 0.0, pi / 2]]).success


def test_the_border_belongs_to_the_domain():
    assert not outcome(DEFAULT, [[4.0, -4.0, 0.0]]).exited
    assert outcome(DEFAULT, [[4.0 + 1e-12, 0.0, 0.0]]).exited


LOT, OUTSIDE, INSIDE = [0.0, 0.0, 0.0], [0.0, 5.0, 0.0], [2.0, 2.0, 0.0]


def test_of_parking_and_leaving_the_earlier_wins():
    parks_first = outcome(DEFAULT, [INSIDE, LOT, OUTSIDE, INSIDE])
    assert (parks_first.reward, parks_first.success, parks_first.exited) == (1000.0, True, False)
    assert (parks_first.terminated, parks_first.last) == (True, 1)
    leaves_first = outcome(DEFAULT, [INSIDE, OUTSIDE, LOT, INSIDE])
    assert (leaves_first.reward, leaves_first.success, leaves_first.exited) == (-1000.0, False, True)
    assert (leaves_first.terminated, leaves_first.last) == (True, 1)


def test_passing_through_the_lot_parks_only_if_it_counts():
    path = [INSIDE, LOT, INSIDE]
    assert outcome(DEFAULT, path).success
    passing = outcome(dataclasses.replace(DEFAULT, park_along_path=False), path)
    assert not passing.success and not passing.terminated
    assert passing.reward == pytest.approx(-np.sin(pi / 4) - D_MAX - 1.0)
    assert outcome(dataclasses.replace(DEFAULT, park_along_path=False), [INSIDE, LOT]).success


def test_parking_beside_the_lot_may_need_its_bearing():
    beside = [[0.0, 0.05, 0.0]]
    assert outcome(DEFAULT, beside).success
    assert not outcome(dataclasses.replace(DEFAULT, success_needs_bearing=True), beside).success


def test_where_leaving_does_not_end_the_episode_each_leaving_path_pays():
    settings = dataclasses.replace(DEFAULT, exit_terminates=False)
    leaves = outcome(settings, [INSIDE, OUTSIDE], start=INSIDE)
    assert (leaves.reward, leaves.exited, leaves.terminated, leaves.last) == (-1000.0, True, False, 1)
    stays_outside = outcome(settings, [OUTSIDE, OUTSIDE], start=OUTSIDE)
    assert not stays_outside.exited and stays_outside.reward > -20.0
    returns = outcome(settings, [OUTSIDE, INSIDE], start=OUTSIDE)
    assert not returns.exited and returns.reward == pytest.approx(-np.sin(pi / 4) - D_MAX - 1.0)


def test_starts_are_uniform_over_the_domain_and_all_headings():
    settings = dataclasses.replace(DEFAULT, half_width=2.5)
    keys = jax.random.split(jax.random.key(0), 3000)
    poses = np.asarray(jax.jit(jax.vmap(parking(settings).reset))(keys))
    for axis, (low, width) in enumerate([(-2.5, 5.0), (-2.5, 5.0), (0.0, 2.0 * pi)]):
        assert stats.kstest(poses[:, axis], "uniform", args=(low, width)).pvalue > 1e-3
    assert np.abs(stats.spearmanr(poses).statistic - np.eye(3)).max() < 0.06
