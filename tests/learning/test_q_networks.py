"""Bootstrapped Q-networks and random network distillation, against plain NumPy and on what they promise."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning.base import Episode, Transition
from bojax.learning.settings import RND, BootstrappedQ
from tests.learning.probes import exploring
from tests.reference import q_networks as reference

OBSERVATIONS = Box(jnp.asarray([-1.0, 0.0]), jnp.asarray([3.0, 2.0]))
ACTIONS = Box(jnp.asarray([-1.0]), jnp.asarray([1.0]))
METHODS = [BootstrappedQ, RND]
SMALL = {"width": 6, "batch_size": 5, "train_every": 3}
NUM_STEPS = 30


def make(schema, **settings):
    heads = {"num_heads": 3} if schema is BootstrappedQ else {"num_outputs": 4}
    learner = build(schema(**(SMALL | heads | {"learning_rate": 0.01, "target_rate": 0.3} | settings)))
    return learner, eqx.filter_jit(learner.init)(jax.random.key(1), OBSERVATIONS, ACTIONS, NUM_STEPS)


def transitions(num=NUM_STEPS, seed=0):
    rng = np.random.default_rng(seed)
    low, high = np.asarray(OBSERVATIONS.low), np.asarray(OBSERVATIONS.high)
    states = rng.uniform(low, high, size=(num + 1, 2))
    return Transition(
        jnp.asarray(states[:-1]),
        jnp.asarray(rng.integers(3, size=(num, 1)) - 1.0),
        jnp.asarray(rng.normal(size=num)),
        jnp.asarray(states[1:]),
        jnp.asarray(rng.uniform(size=num) < 0.2),
    )


@eqx.filter_jit
def learn(learner, state, steps, exploration=exploring()):  # noqa: B008 (a constant)
    """Observe transitions in blocks of `train_every`: the states before each gradient step, and the last."""

    def observe(state, number_and_step):
        number, step = number_and_step
        place = number % learner.train_every
        return learner.observe(jax.random.key(number), state, step, exploration, place), None

    def block(state, rows):
        state, _ = jax.lax.scan(observe, state, rows)
        return learner.flush(state), (state.index, state.extra)

    num = len(steps.reward) // learner.train_every
    rows = jnp.arange(len(steps.reward), dtype=jnp.int32), steps
    blocks = jax.tree.map(lambda x: x.reshape(num, learner.train_every, *x.shape[1:]), rows)
    return jax.lax.scan(block, state, blocks)


def numpy_network(network, head=...):
    layers = [(np.array(layer.weight)[head], np.array(layer.bias)[head]) for layer in network.layers]
    return reference.Network(*map(list, zip(*layers, strict=True)))


def numpy_rows(steps):
    """What the networks see of transitions: inputs in [-1, 1], numbers of actions, rewards, and so on."""
    low, high = np.asarray(OBSERVATIONS.low), np.asarray(OBSERVATIONS.high)
    x, x2 = (
        2.0 * (np.asarray(s) - low) / (high - low) - 1.0 for s in (steps.observation, steps.next_observation)
    )
    return (
        x,
        np.asarray(steps.action)[:, 0].astype(int) + 1,
        np.asarray(steps.reward),
        x2,
        1.0 - np.asarray(steps.terminated),
    )


def same(network, expected, head=...):
    found = numpy_network(network, head).parameters
    return all(np.allclose(a, b, rtol=0, atol=1e-9) for a, b in zip(found, expected.parameters, strict=True))


def test_bootstrapped_updates_are_those_of_plain_numpy():
    learner, state = make(BootstrappedQ, discount=0.9, prior_scale=2.0)
    heads = range(3)
    expected = reference.BootstrappedQ(
        [numpy_network(state.trained, k) for k in heads],
        [numpy_network(state.fixed, k) for k in heads],
        discount=0.9,
        prior_scale=2.0,
        learning_rate=0.01,
        target_rate=0.3,
    )
    steps = transitions()
    after, (samples, _) = learn(learner, state, steps)
    rows, masks = numpy_rows(steps), eqx.filter_jit(learner.masks)
    for index in np.asarray(samples):
        expected.step(*(row[index] for row in rows), np.asarray(masks(state, jnp.asarray(index))))
    assert all(same(after.trained, expected.heads[k], k) for k in heads)
    assert all(same(after.target, expected.targets[k], k) for k in heads)
    assert not same(state.trained, expected.heads[0], 0)
    _, _, reward, x2, goes_on = (row[np.asarray(after.index)] for row in rows)
    found = eqx.filter_jit(lambda state: learner.td_targets(state, learner.batch(state)))(after)
    np.testing.assert_allclose(found, expected.td_targets(reward, x2, goes_on), atol=1e-9)


def test_rnd_updates_are_those_of_plain_numpy():
    learner, state = make(RND, discount=0.9, u_discount=0.8, kappa=2.0)
    expected = reference.RND(
        numpy_network(state.trained.values),
        numpy_network(state.trained.predictor),
        numpy_network(state.fixed),
        discount=0.9,
        u_discount=0.8,
        kappa=2.0,
        learning_rate=0.01,
        target_rate=0.3,
    )
    steps = transitions()
    after, (samples, _) = learn(learner, state, steps)
    rows = numpy_rows(steps)
    for number, index in enumerate(np.asarray(samples)):
        for x2 in rows[3][number * learner.train_every :][: learner.train_every]:
            expected.observe(x2)
        expected.step(*(row[index] for row in rows))
    assert same(after.trained.values, expected.values)
    assert same(after.trained.predictor, expected.predictor)
    assert same(after.target.values, expected.target)
    np.testing.assert_allclose(after.extra.deviation, np.std(expected.sums), rtol=1e-9)
    _, _, reward, x2, goes_on = (row[np.asarray(after.index)] for row in rows)
    found = eqx.filter_jit(lambda state: learner.td_targets(state, learner.batch(state)))(after)
    np.testing.assert_allclose(found, expected.td_targets(reward, x2, goes_on), atol=1e-9)


@pytest.mark.parametrize("schema", METHODS)
def test_samples_are_transitions_that_were_observed(schema):
    learner, state = make(schema)
    _, (samples, _) = learn(learner, state, transitions())
    seen = np.arange(1, len(samples) + 1) * learner.train_every
    assert (np.asarray(samples) < seen[:, None]).all()
    assert len(np.unique(samples)) > NUM_STEPS // 2


def test_heads_learn_from_the_transitions_of_their_masks_alone():
    learner, state = make(BootstrappedQ, mask_probability=0.3)
    index, draw = jnp.arange(4000, dtype=jnp.int32), eqx.filter_jit(learner.masks)
    masks = np.asarray(draw(state, index))
    # The mean of 4,000 draws has a standard deviation of 0.007; independent heads share 9% of their masks.
    assert np.abs(masks.mean(axis=0) - 0.3).max() < 0.03
    assert abs(masks[:, :2].all(axis=1).mean() - 0.09) < 0.02
    np.testing.assert_array_equal(draw(state, index[5:9]), masks[5:9])

    (place,) = np.flatnonzero(masks[:, 0] & ~masks[:, 1])[:1]
    state = learn(learner, state, transitions())[0]
    state = eqx.tree_at(lambda s: s.index, state, jnp.full_like(state.index, place % NUM_STEPS))
    place = int(state.index[0])
    gradient = eqx.filter_jit(
        lambda state: jax.grad(learner.loss)(state.trained, state, learner.batch(state))
    )(state)
    for leaf in jax.tree.leaves(gradient):
        moves = np.any(np.asarray(leaf) != 0.0, axis=tuple(range(1, leaf.ndim)))
        assert not moves[~masks[place]].any()
    last = gradient.layers[-1].bias
    np.testing.assert_array_equal(np.any(np.asarray(last) != 0.0, axis=1), masks[place])


def test_a_head_acts_for_an_episode_and_their_mean_in_a_test():
    learner, state = make(BootstrappedQ)
    observation = jnp.asarray([0.3, 1.2])
    q = np.asarray(
        jax.jit(lambda x: learner.q(state.trained, state.fixed, learner.inputs(state, x)))(observation)
    )
    act = eqx.filter_jit(learner.act)
    for head in range(3):
        acting = eqx.tree_at(lambda s: s.extra.head, state, jnp.asarray(head, jnp.int32))
        for scale, expected in ((1.0, q[head]), (0.0, q.mean(axis=0))):
            action, value = act(jax.random.key(0), acting, observation, exploring(scale))
            assert float(action[0]) == expected.argmax() - 1.0
            np.testing.assert_allclose(value, expected.max(), atol=1e-12)
    episode = Episode(transitions(3), jnp.asarray(3, jnp.int32))
    ends = eqx.filter_jit(lambda key: learner.end_episode(key, state, episode, exploring()).extra.head)
    assert {int(ends(jax.random.key(seed))) for seed in range(30)} == {0, 1, 2}


@pytest.mark.parametrize("schema", METHODS)
def test_without_learning_nothing_changes(schema):
    learner, state = make(schema)
    learned, _ = learn(learner, state, transitions())
    again, _ = learn(learner, learned, transitions(seed=1), exploring(is_learning=False))
    assert eqx.tree_equal(*jax.device_get((again, learned)))


@pytest.mark.parametrize("schema", METHODS)
def test_states_of_a_discrete_space_are_one_hot(schema):
    learner, _ = make(schema)

    def init(capacity):
        return learner.init(jax.random.key(0), Discrete(4), Discrete(2), capacity)

    state = eqx.filter_jit(lambda: init(10))()
    np.testing.assert_array_equal(learner.inputs(state, jnp.int32(2)), [0.0, 0.0, 1.0, 0.0])
    assert state.actions.tolist() == [0, 1]
    empty = eqx.filter_eval_shape(lambda: init(0))
    assert eqx.filter_eval_shape(learner.policy_state, state) == empty


def test_values_are_those_of_the_networks():
    observation, action = jnp.asarray([0.3, 1.2]), jnp.asarray([1.0])
    learner, state = make(BootstrappedQ)
    q = learner.q(state.trained, state.fixed, learner.inputs(state, observation))[:, 2]
    np.testing.assert_allclose(learner.values(state, observation, action), [q.mean(), q.std()])
    learner, state = make(RND)
    values = learner.q_and_u(state.trained, learner.inputs(state, observation))
    np.testing.assert_array_equal(learner.values(state, observation, action), values[:, 2])
