"""Taxi against Gymnasium's transition table, and its exact solution."""

from collections import Counter

import gymnasium
import jax
import numpy as np
import pytest

from bojax.envs.settings import Taxi
from tests.envs.tables import branches, part, tables
from tests.reference.tabular import value_iteration

PICK_UP, DROP_OFF = 4, 5


@pytest.fixture(scope="module")
def published():
    return gymnasium.make("Taxi-v4").unwrapped


@pytest.fixture(scope="module")
def goal_only():
    return branches(part(Taxi()))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_classic_rewards_are_gymnasiums_table(published, dtype):
    ours = branches(part(Taxi(reward="classic"), dtype))
    assert len(ours) == 500 * 6
    for (state, action), outcomes in ours.items():
        [(p, after, reward, end)] = published.P[state][action]
        assert outcomes == {(int(after), float(reward), bool(end)): p}


def test_goal_only_rewards_pay_the_right_drop_off_and_punish_wrong_ones(published, goal_only):
    for (state, action), outcomes in goal_only.items():
        [(after, reward, end)] = outcomes
        [(_, same, classic, same_end)] = published.P[state][action]
        assert (after, end) == (same, same_end)
        if end:
            assert reward == 1.0
        elif action in (PICK_UP, DROP_OFF):
            is_right = action == PICK_UP and classic == -1
            assert reward == (0.0 if is_right else -0.1)
        else:
            assert reward == 0.0


def test_the_reward_scale_multiplies_every_reward(goal_only):
    for pair, outcomes in branches(part(Taxi(reward_scale=100.0))).items():
        [(after, reward, end)] = outcomes
        [(_, unscaled, _)] = goal_only[pair]
        assert reward == pytest.approx(100.0 * unscaled)


def test_episodes_begin_in_gymnasiums_300_states_alike(published):
    env = part(Taxi())
    starts = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 30_000))
    counts = np.bincount(np.asarray(starts), minlength=500)
    possible = published.initial_state_distrib > 0
    assert possible.sum() == 300
    assert np.all(counts[~possible] == 0)
    # Pearson's statistic of 299 degrees of freedom: mean 299, standard deviation 24.5.
    assert np.sum((counts[possible] - 100.0) ** 2 / 100.0) < 299 + 5 * 24.5


def test_every_passenger_can_be_brought_home_within_20_steps(goal_only, published):
    probability, to = tables(part(Taxi(reward="classic")))
    q = value_iteration(probability, to.observation, to.reward, to.terminated, 1.0)
    best = q.max(axis=1)[published.initial_state_distrib > 0]
    steps = Counter((21 - best).astype(int).tolist())  # 20 at the end, -1 for each step before it
    assert max(steps) <= 20
    assert min(steps) > 1
    probability, to = tables(part(Taxi()))
    q = value_iteration(probability, to.observation, to.reward, to.terminated, 0.9)
    goal_only_best = q.max(axis=1)[published.initial_state_distrib > 0]
    assert goal_only_best == pytest.approx(0.9 ** (20 - best))
