"""Cliff walking against Gymnasium's transition table, and its exact solution."""

import gymnasium
import pytest

from bojax.envs.settings import CliffWalking
from tests.envs.tables import branches, frequencies, part, tables
from tests.reference.tabular import value_iteration

UP, RIGHT, _, LEFT = range(4)


@pytest.fixture(scope="module")
def published():
    return gymnasium.make("CliffWalking-v1").unwrapped.P


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_classic_rewards_without_slips_are_gymnasiums_table(published, dtype):
    ours = branches(part(CliffWalking(reward="classic", slip=0.0), dtype))
    assert len(ours) == 48 * 4
    for (state, action), outcomes in ours.items():
        assert outcomes == {
            (int(after), float(reward), end): p for p, after, reward, end in published[state][action]
        }


def test_a_slip_draws_one_of_the_four_directions(published):
    ours = branches(part(CliffWalking(reward="classic", slip=0.2)))
    for (state, action), outcomes in ours.items():
        expected: dict = {}
        for direction in range(4):
            [(_, after, reward, end)] = published[state][direction]
            p = 0.05 + 0.8 * (direction == action)
            key = (int(after), float(reward), bool(end))
            expected[key] = expected.get(key, 0.0) + p
        assert outcomes == pytest.approx(expected)


def test_goal_only_rewards_pay_the_goal_and_punish_falls():
    for (state, action), outcomes in branches(part(CliffWalking(slip=0.0, reward_scale=100.0))).items():
        [(after, reward, end)] = outcomes
        fell = after == 36 and state not in (24, 36) and (state, action) != (37, LEFT)
        assert reward == (100.0 if end else -100.0 if fell or (state, action) == (36, RIGHT) else 0.0)
        assert end == (after == 47)


def test_the_best_way_takes_13_steps():
    probability, to = tables(part(CliffWalking(reward="classic", slip=0.0)))
    q = value_iteration(probability, to.observation, to.reward, to.terminated, 1.0)
    assert q[36].max() == -13.0
    probability, to = tables(part(CliffWalking(slip=0.0)))
    q = value_iteration(probability, to.observation, to.reward, to.terminated, 0.9)
    assert q[36].max() == pytest.approx(0.9**12)


def test_an_action_outside_is_clipped():
    env = part(CliffWalking(slip=0.0))
    assert frequencies(env, 30, 7, draws=1) == frequencies(env, 30, LEFT, draws=1)
    assert frequencies(env, 30, -3, draws=1) == frequencies(env, 30, UP, draws=1)
