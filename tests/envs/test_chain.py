"""The chain: its table, and how long walks take that know nothing."""

import jax
import numpy as np
import pytest
from pydantic import ValidationError

from bojax.envs.settings import Chain
from tests.envs.tables import branches, frequencies, part, tables
from tests.reference.tabular import hitting_time

LEFT, RIGHT = 0, 1


def test_action_left_moves_left_and_right_slips_with_probability_1_over_n():
    ours = branches(part(Chain(length=5, max_length=5)))
    for state in range(4):
        left = max(state - 1, 0), 0.0, False
        right = state + 1, 1.0 if state == 3 else 0.0, state == 3
        assert ours[state, LEFT] == {left: 1.0}
        assert ours[state, RIGHT] == pytest.approx({right: 0.8, left: 0.2})


def test_semi_sparse_rewards_punish_every_state_but_the_goal():
    ours = branches(part(Chain(length=4, max_length=4, sparsity=0.25)))
    assert ours[0, LEFT] == pytest.approx({(0, 0.0, False): 0.25, (0, -1.0, False): 0.75})
    assert ours[2, RIGHT] == pytest.approx(
        {(3, 1.0, True): 0.75, (1, 0.0, False): 0.0625, (1, -1.0, False): 0.1875}
    )


def test_steps_follow_the_table():
    env = part(Chain(length=4, max_length=6, sparsity=0.3))
    for state, action in ((0, LEFT), (1, RIGHT), (2, RIGHT)):
        expected, found = branches(env)[state, action], frequencies(env, state, action)
        assert found.keys() <= expected.keys()
        for outcome, p in expected.items():
            assert found.get(outcome, 0.0) == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / 4000))


@pytest.mark.parametrize("length, steps", [(10, 190), (20, 816), (100, 21_628)])
def test_a_random_walk_takes_about_twice_the_square_of_the_length(length, steps):
    probability, to = tables(part(Chain(length=length, max_length=length)))
    policy = np.full((length, 2), 0.5)
    assert round(hitting_time(probability, to.observation, to.terminated, policy, start=0)) == steps


def test_the_length_is_a_number_and_the_declared_space_is_not():
    short, long = part(Chain(length=5, max_length=20)), part(Chain(length=20, max_length=20))
    assert jax.tree.structure(short) == jax.tree.structure(long)
    assert short.observation_space.num == long.observation_space.num == 20
    assert int(part(Chain(start=3)).reset(jax.random.key(0))) == 3
    own = branches(part(Chain(length=5, max_length=5)))
    assert {pair: outcomes for pair, outcomes in branches(short).items() if pair[0] < 5} == own


@pytest.mark.parametrize("settings", [{"length": 21}, {"length": 5, "start": 4}])
def test_a_chain_that_does_not_fit_is_refused(settings):
    with pytest.raises(ValidationError, match=r"at most max_length|less than length - 1"):
        Chain(**settings)
