"""VIME: an iteration in plain NumPy, its pool and batches, and goals that it finds."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.spaces import Box
from bojax.learning.base import Episode, Transition
from bojax.learning.settings import VIME
from bojax.learning.trpo import TRPO, Samples
from bojax.numerics.lanes import LANES
from tests.learning.probes import exploring
from tests.reference import vime as reference
from tests.reference.q_networks import Adam
from tests.tiers import by_tier

OBSERVATIONS = Box(jnp.asarray([-1.0, -2.0]), jnp.asarray([1.0, 4.0]))
ACTIONS = Box(jnp.asarray([-3.0]), jnp.asarray([1.0]))
MOST_STEPS = 9
EXPLORING = exploring()
SMALL = {
    "iteration_steps": 10,
    "longest_episode": MOST_STEPS,
    "policy_units": [5],
    "model_units": 4,
    "model_updates": 7,
    "model_batch": 3,
    "num_samples": 2,
    "min_pool": 0.0,
    "eta": 0.5,
    "damping": 0.1,  # with so few rows the Fisher matrix is singular, and steps depend on rounding errors
}


def make(**settings):
    learner = build(VIME.model_validate({**SMALL, **settings}))
    return learner, eqx.filter_jit(learner.init)(jax.random.key(1), OBSERVATIONS, ACTIONS, 1000)


def episode(seed: int, length: int, reward: float = 1.0) -> Episode:
    """A random walk, padded with rows that must not matter."""
    rng = np.random.default_rng(seed)
    walk = rng.normal(size=(MOST_STEPS + 1, 2))
    steps = Transition(
        jnp.asarray(walk[:-1]),
        jnp.asarray(rng.normal(size=(MOST_STEPS, 1))),
        jnp.asarray(reward * rng.normal(size=MOST_STEPS)),
        jnp.asarray(walk[1:]),
        jnp.asarray(np.arange(MOST_STEPS) == length - 1),
    )
    return Episode(steps, jnp.asarray(length, jnp.int32))


@eqx.filter_jit
def end_episode(learner, key, state, episode, exploration=EXPLORING):
    return learner.end_episode(key, state, episode, exploration)


def learn(learner, state, lengths, exploration=EXPLORING, **settings):
    """The states after the ends of some episodes; the key and the walk of an episode have its number."""
    states = []
    for number, length in enumerate(lengths):
        data = episode(number, length, **settings)
        state = end_episode(learner, jax.random.key(number), state, data, exploration)
        states.append(state)
    return states


def scaled(space: Box, values) -> np.ndarray:
    low, high = np.asarray(space.low), np.asarray(space.high)
    return 2 * (np.asarray(values) - low) / (high - low) - 1


def rows_of(numbers, lengths):
    """Observations, actions, rewards and next observations of some episodes, a list of paths each."""
    steps = [episode(n, length).transitions for n, length in zip(numbers, lengths, strict=True)]
    return [
        [np.asarray(part[:length]) for part, length in zip(parts, lengths, strict=True)]
        for parts in (
            [scaled(OBSERVATIONS, s.observation) for s in steps],
            [scaled(ACTIONS, s.action) for s in steps],
            [np.asarray(s.reward) for s in steps],
            [scaled(OBSERVATIONS, s.next_observation) for s in steps],
        )
    ]


def standardised(pool, observations, actions, next_observations):
    """Inputs and outputs of the model, by the statistics of observations and actions of the pool."""
    scale = [(rows.mean(axis=0), rows.std(axis=0) + 1e-4) for rows in pool]
    o, a, o2 = (
        (x - scale[k][0]) / scale[k][1]
        for x, k in zip((observations, actions, next_observations), (0, 1, 0), strict=True)
    )
    return np.hstack([o, a]), o2


@eqx.filter_jit
def draw_noise(model, key, shape):
    return model.draw_noise(key, shape)


def numpy_model(learner, state):
    numbers = (learner.prior_deviation, learner.likelihood_deviation, learner.num_batches)
    return reference.Model([np.array(x) for x in jax.tree.leaves(state.model)], *map(float, numbers))


def update_of_numpy(learner, model, adam, key, pool):
    """The updates of an iteration; batches and noise are the draws of the learner."""
    key_rows, key_noise = jax.random.split(jax.random.split(key)[1])
    observations, actions, next_observations = (np.concatenate(part) for part in pool)
    shape = learner.model_updates, learner.model_batch
    draws = np.asarray(jax.random.uniform(key_rows, (shape[0] * shape[1],), jnp.float32))
    rows = (draws * len(actions)).astype(int).reshape(shape)
    _, state = make()
    noise = draw_noise(state.model, key_noise, (learner.model_updates, learner.num_samples))
    noise = [np.asarray(part) for part in noise]
    for number, chosen in enumerate(rows):
        parts = observations[chosen], actions[chosen], next_observations[chosen]
        inputs, outputs = standardised((observations, actions), *parts)
        draws = [part[number] for part in noise]
        adam(model.parameters, model.loss(draws, inputs, outputs)[1])


def test_two_iterations_are_those_of_numpy():
    learner, start = make()
    lengths = (4, 7, 5, 1, 9)
    states = learn(learner, start, lengths)
    assert [int(s.iterations) for s in states] == [0, 1, 1, 1, 2]

    # Iteration 0: no bonus.
    first = states[1]
    np.testing.assert_array_equal(first.medians, 0.0)
    observations, actions, rewards, next_observations = rows_of((0, 1), lengths[:2])
    model = numpy_model(learner, start)
    adam = Adam(float(learner.model_learning_rate))
    pool = [observations, actions, next_observations]
    update_of_numpy(learner, model, adam, jax.random.key(1), pool)
    for got, wanted in zip(jax.tree.leaves(first.model), model.parameters, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)
    gains = [reference.advantages(r, np.zeros_like(r), 0.99, 1.0) for r in rewards]
    check_policy(learner, start, first, observations, actions, gains)
    returns = [reference.returns(r, 0.99) for r in rewards]
    check_baseline(first, observations, returns)

    # Iteration 1: the bonus is that of the model and the pool of iteration 0.
    second = states[-1]
    observations, actions, rewards, next_observations = rows_of((2, 3, 4), lengths[2:])
    statistics = [np.concatenate(part) for part in pool[:2]]
    bonuses, row = [], 0
    key_bonus = jax.random.split(jax.random.key(4))[0]
    for parts in zip(observations, actions, next_observations, strict=True):
        inputs, outputs = standardised(statistics, *parts)
        noise = []
        for _ in inputs:
            draws = draw_noise(first.model, jax.random.fold_in(key_bonus, row), (learner.num_samples,))
            noise.append([np.asarray(part) for part in draws])
            row += 1
        bonuses.append(reference.path_bonuses(model, noise, inputs, outputs, 0.01, 1000.0))
    median = np.median(np.concatenate(bonuses))
    np.testing.assert_allclose(second.medians[0], median, rtol=1e-9)
    np.testing.assert_array_equal(second.medians[1:], 0.0)
    values = [reference.baseline_features(o) @ np.asarray(first.baseline.weights) for o in observations]
    gains = [
        reference.advantages(r + 0.5 * b / median, v, 0.99, 1.0)
        for r, b, v in zip(rewards, bonuses, values, strict=True)
    ]
    check_policy(learner, first, second, observations, actions, gains)
    check_baseline(second, observations, [reference.returns(r, 0.99) for r in rewards])
    pool = [a + b for a, b in zip(pool, (observations, actions, next_observations), strict=True)]
    update_of_numpy(learner, model, adam, jax.random.key(4), pool)
    for got, wanted in zip(jax.tree.leaves(second.model), model.parameters, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-8, atol=1e-12)


def check_policy(learner, before, after, observations, actions, gains):
    """The policy is that of a TRPO step with these advantages, and another one than before."""
    gains = np.concatenate(gains)
    gains = (gains - gains.mean()) / (gains.std() + 1e-8)
    parts = (np.concatenate(part) for part in (observations, actions))
    samples = Samples(*map(jnp.asarray, parts), jnp.asarray(gains), jnp.ones(len(gains), bool))
    numbers = learner.max_kl, learner.damping, learner.backtrack_ratio
    improved = eqx.filter_jit(TRPO(*numbers, learner.cg_steps, learner.backtracks).improved)
    expected = improved(before.policy, samples, jnp.asarray(True))
    leaves = zip(*map(jax.tree.leaves, (after.policy, expected, before.policy)), strict=True)
    for got, wanted, old in leaves:
        np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-9)
        assert not np.array_equal(got, old)


def check_baseline(state, observations, returns):
    """The baseline is nearly a least squares fit of the returns."""
    features = np.vstack([reference.baseline_features(o) for o in observations])
    returns = np.concatenate(returns)
    best, _, _, _ = np.linalg.lstsq(features, returns, rcond=None)
    least = np.mean((features @ best - returns) ** 2)
    assert np.mean((features @ np.asarray(state.baseline.weights) - returns) ** 2) < 1.02 * least + 1e-3


def numbered(number: int, length: int) -> Episode:
    """An episode whose observations tell the episode and the step."""
    steps = 100.0 * number + np.arange(MOST_STEPS + 1)
    walk = np.c_[steps, -steps]
    blank = jnp.zeros(MOST_STEPS)
    transitions = Transition(
        jnp.asarray(walk[:-1]), jnp.asarray(walk[:-1, :1]), blank, jnp.asarray(walk[1:]), blank > 0
    )
    return Episode(transitions, jnp.asarray(length, jnp.int32))


SHORT = {"longest_episode": 4, "iteration_steps": 6}


@pytest.mark.parametrize("pool_size", by_tier([1000, 20, 7], normal=[20]))
def test_the_pool_keeps_the_latest_transitions_and_pairs_no_episodes(pool_size):
    learner, state = make(pool_size=pool_size, **SHORT)
    lengths, seen = (4, 7, 9, 9, 1, 9, 3, 8), []
    for number, length in enumerate(lengths):
        state = end_episode(learner, jax.random.key(number), state, numbered(number, length))
        seen += [100 * number + step for step in range(min(length, SHORT["longest_episode"]))]
        if not int(state.batch.memory.count):  # an iteration has taken place
            size = int(state.pool.size)
            assert size == min(len(seen), pool_size)
            before, after = (
                np.asarray(x[:size, 0]) for x in (state.pool.observations, state.pool.next_observations)
            )
            np.testing.assert_array_equal(after, before + 1)  # also across the border of two episodes
            assert sorted(before) == seen[-size:]
            np.testing.assert_array_equal(state.pool.actions[:size, 0], before)
            np.testing.assert_array_equal(state.pool.is_filled, np.arange(pool_size) < size)
    assert int(state.iterations) == 3


def test_a_long_episode_is_cut_and_a_short_batch_waits():
    learner, state = make(pool_size=20, **SHORT)
    states = learn(learner, state, (9, 1, 2))
    assert [int(s.batch.memory.count) for s in states] == [4, 5, 0]
    np.testing.assert_array_equal(states[1].batch.steps[:5], [0, 1, 2, 3, 0])
    np.testing.assert_array_equal(states[1].batch.is_last, [False] * 3 + [True] * 6)


def test_without_learning_nothing_changes():
    learner, state = make()
    *_, state = learn(learner, state, (4, 7, 3))
    after = learn(learner, state, (9, 9), exploring(is_learning=False))[-1]
    for a, b in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("axis_name", by_tier([LANES, None], normal=[LANES]))
def test_lanes_that_are_due_at_different_times_are_independent(axis_name):
    learner, start = make()
    lengths = np.array([[9, 9, 9, 9], [4, 7, 5, 2], [1, 2, 3, 9]])
    keys = [jax.random.key(number) for number in range(lengths.shape[1])]
    states = jax.jit(lambda state: jax.tree.map(lambda x: jnp.stack([x] * len(lengths)), state))(start)
    step = eqx.filter_jit(
        eqx.filter_vmap(
            lambda learner, key, state, episode: learner.end_episode(key, state, episode, EXPLORING),
            in_axes=(None, None, 0, 0),
            axis_name=axis_name,
        )
    )
    with jax.debug_key_reuse(False):  # the check takes a batched scan for a reuse
        for number, key in enumerate(keys):
            episodes = [episode(number, length) for length in lengths[:, number]]
            states = step(learner, key, states, jax.tree.map(lambda *x: np.stack(x), *episodes))
    np.testing.assert_array_equal(states.iterations, [2, 1, 1])
    for lane, row in enumerate(lengths):
        alone = learn(learner, start, row)[-1]
        for a, b in zip(jax.tree.leaves(states), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(np.asarray(a)[lane], b, rtol=1e-7, atol=1e-9)


def test_a_test_takes_the_most_probable_action():
    learner, state = make()
    *_, state = learn(learner, state, (9, 9))
    observation = jnp.asarray([0.3, 1.0])
    act = jax.jit(jax.vmap(lambda key, e: learner.act(key, state, observation, e)[0], in_axes=(0, None)))
    keys = jax.random.split(jax.random.key(0), (2, 2000))
    testing = exploring(0.0, is_learning=False)
    policy = eqx.filter_jit(state.policy)
    mean = np.asarray(policy(jnp.asarray(scaled(OBSERVATIONS, observation))).mean)
    expected = -1.0 + 2.0 * mean  # of the action space
    np.testing.assert_allclose(act(keys[0], testing), np.broadcast_to(expected, (2000, 1)), rtol=1e-12)
    drawn = np.asarray(act(keys[1], EXPLORING))
    np.testing.assert_allclose(drawn.mean(axis=0), expected, atol=0.2)
    deviation = 2.0 * np.exp(np.asarray(state.policy.log_deviation))
    np.testing.assert_allclose(drawn.std(axis=0), deviation, rtol=0.1)


def test_the_exported_state_acts_and_has_the_shapes_of_a_learner_without_capacity():
    learner, state = make()
    *_, state = learn(learner, state, (9, 9, 3))
    exported = learner.policy_state(state)
    new = eqx.filter_eval_shape(lambda: learner.init(jax.random.key(5), OBSERVATIONS, ACTIONS, 0))
    assert eqx.filter_eval_shape(lambda state: state, exported) == new
    arguments = jnp.asarray([0.3, 1.0]), EXPLORING
    act = eqx.filter_jit(learner.act)
    first, second = (act(jax.random.key(0), s, *arguments) for s in (state, exported))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])
