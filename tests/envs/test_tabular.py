"""The tabular environments: Gymnasium's transition tables, exact solutions, and how long walks take."""

import gymnasium
import jax
import numpy as np
import pytest
from pydantic import ValidationError

from bojax.engine.build import build
from bojax.envs.settings import Chain, CliffWalking, Taxi
from tests.envs.tables import branches, frequencies, tables
from tests.reference.tabular import hitting_time, value_iteration

UP, RIGHT, _, LEFT = range(4)
PICK_UP, DROP_OFF = 4, 5
BACK, ON = range(2)
"""The actions of cliff walking, those of the taxi besides, and those of the chain."""


def best_values(schema, discount):
    """Q of the best policy, from the table."""
    probability, to = tables(build(schema))
    return value_iteration(probability, to.observation, to.reward, to.terminated, discount)


@pytest.fixture(scope="module")
def cliff():
    return gymnasium.make("CliffWalking-v1").unwrapped.P


@pytest.fixture(scope="module")
def taxi():
    return gymnasium.make("Taxi-v4").unwrapped


@pytest.fixture(scope="module")
def goal_only():
    return branches(build(Taxi()))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("schema", [CliffWalking(reward="classic", slip=0.0), Taxi(reward="classic")])
def test_classic_rewards_without_slips_are_gymnasiums_table(schema, dtype, cliff, taxi):
    ours, published = branches(build(schema, dtype)), cliff if schema.kind == "cliff-walking" else taxi.P
    assert len(ours) == (48 * 4 if schema.kind == "cliff-walking" else 500 * 6)
    for (state, action), outcomes in ours.items():
        [(p, after, reward, end)] = published[state][action]
        assert outcomes == {(int(after), float(reward), bool(end)): p}


def test_a_slip_draws_one_of_the_four_directions(cliff):
    ours = branches(build(CliffWalking(reward="classic", slip=0.2)))
    for (state, action), outcomes in ours.items():
        expected: dict = {}
        for direction in range(4):
            [(_, after, reward, end)] = cliff[state][direction]
            p = 0.05 + 0.8 * (direction == action)
            key = (int(after), float(reward), bool(end))
            expected[key] = expected.get(key, 0.0) + p
        assert outcomes == pytest.approx(expected)


def test_goal_only_rewards_of_the_cliff_pay_the_goal_and_punish_falls():
    for (state, action), outcomes in branches(build(CliffWalking(slip=0.0, reward_scale=100.0))).items():
        [(after, reward, end)] = outcomes
        fell = after == 36 and state not in (24, 36) and (state, action) != (37, LEFT)
        assert reward == (100.0 if end else -100.0 if fell or (state, action) == (36, RIGHT) else 0.0)
        assert end == (after == 47)


def test_the_best_way_along_the_cliff_takes_13_steps():
    assert best_values(CliffWalking(reward="classic", slip=0.0), 1.0)[36].max() == -13.0
    assert best_values(CliffWalking(slip=0.0), 0.9)[36].max() == pytest.approx(0.9**12)


def test_an_action_outside_is_clipped():
    env = build(CliffWalking(slip=0.0))
    assert frequencies(env, 30, 7, draws=1) == frequencies(env, 30, LEFT, draws=1)
    assert frequencies(env, 30, -3, draws=1) == frequencies(env, 30, UP, draws=1)


def test_goal_only_rewards_of_the_taxi_pay_the_right_drop_off_and_punish_wrong_ones(taxi, goal_only):
    for (state, action), outcomes in goal_only.items():
        [(after, reward, end)] = outcomes
        [(_, same, classic, same_end)] = taxi.P[state][action]
        assert (after, end) == (same, same_end)
        if end:
            assert reward == 1.0
        elif action in (PICK_UP, DROP_OFF):
            is_right = action == PICK_UP and classic == -1
            assert reward == (0.0 if is_right else -0.1)
        else:
            assert reward == 0.0


def test_the_reward_scale_of_the_taxi_multiplies_every_reward(goal_only):
    for pair, outcomes in branches(build(Taxi(reward_scale=100.0))).items():
        [(after, reward, end)] = outcomes
        [(_, unscaled, _)] = goal_only[pair]
        assert reward == pytest.approx(100.0 * unscaled)


def test_episodes_of_the_taxi_begin_in_gymnasiums_300_states_alike(taxi):
    env = build(Taxi())
    starts = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 30_000))
    counts = np.bincount(np.asarray(starts), minlength=500)
    possible = taxi.initial_state_distrib > 0
    assert possible.sum() == 300
    assert np.all(counts[~possible] == 0)
    # Pearson's statistic of 299 degrees of freedom: mean 299, standard deviation 24.5.
    assert np.sum((counts[possible] - 100.0) ** 2 / 100.0) < 299 + 5 * 24.5


def test_every_passenger_can_be_brought_home_within_20_steps(taxi):
    possible = taxi.initial_state_distrib > 0
    best = best_values(Taxi(reward="classic"), 1.0).max(axis=1)[possible]
    steps = 21 - best  # 20 at the end, -1 for each step before it
    assert 1 < min(steps) and max(steps) <= 20
    goal_only_best = best_values(Taxi(), 0.9).max(axis=1)[possible]
    assert goal_only_best == pytest.approx(0.9 ** (20 - best))


def test_an_action_back_moves_back_and_on_slips_with_probability_1_over_n():
    ours = branches(build(Chain(length=5, max_length=5)))
    for state in range(4):
        left = max(state - 1, 0), 0.0, False
        right = state + 1, 1.0 if state == 3 else 0.0, state == 3
        assert ours[state, BACK] == {left: 1.0}
        assert ours[state, ON] == pytest.approx({right: 0.8, left: 0.2})


def test_semi_sparse_rewards_punish_every_state_but_the_goal():
    ours = branches(build(Chain(length=4, max_length=4, sparsity=0.25)))
    assert ours[0, BACK] == pytest.approx({(0, 0.0, False): 0.25, (0, -1.0, False): 0.75})
    assert ours[2, ON] == pytest.approx(
        {(3, 1.0, True): 0.75, (1, 0.0, False): 0.0625, (1, -1.0, False): 0.1875}
    )


def test_steps_of_the_chain_follow_the_table():
    env = build(Chain(length=4, max_length=6, sparsity=0.3))
    for state, action in ((0, BACK), (1, ON), (2, ON)):
        expected, found = branches(env)[state, action], frequencies(env, state, action)
        assert found.keys() <= expected.keys()
        for outcome, p in expected.items():
            assert found.get(outcome, 0.0) == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / 4000))


@pytest.mark.parametrize("length, steps", [(10, 190), (20, 816), (100, 21_628)])
def test_a_random_walk_takes_about_twice_the_square_of_the_length(length, steps):
    probability, to = tables(build(Chain(length=length, max_length=length)))
    policy = np.full((length, 2), 0.5)
    assert round(hitting_time(probability, to.observation, to.terminated, policy, start=0)) == steps


def test_the_length_is_a_number_and_the_declared_space_is_not():
    short, long = build(Chain(length=5, max_length=20)), build(Chain(length=20, max_length=20))
    assert jax.tree.structure(short) == jax.tree.structure(long)
    assert short.observation_space.num == long.observation_space.num == 20
    assert int(build(Chain(start=3)).reset(jax.random.key(0))) == 3
    own = branches(build(Chain(length=5, max_length=5)))
    assert {pair: outcomes for pair, outcomes in branches(short).items() if pair[0] < 5} == own


@pytest.mark.parametrize("settings", [{"length": 21}, {"length": 5, "start": 4}])
def test_a_chain_that_does_not_fit_is_refused(settings):
    with pytest.raises(ValidationError, match=r"at most max_length|less than length - 1"):
        Chain(**settings)
