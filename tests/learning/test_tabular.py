"""Tabular learners against plain NumPy, on probes with known values, and on what they promise."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.settings import Chain
from bojax.envs.spaces import Box, Discrete
from bojax.experiments.learning import LearningRun
from bojax.experiments.settings import Learning
from bojax.learning.base import ExplorationState, Transition
from bojax.learning.settings import AdditiveRewards, EpsilonGreedy, ExplorationValues
from tests.envs.tables import tables
from tests.learning.probes import Loop, exploring
from tests.reference.tabular import QLearning, value_iteration

LEARNERS = [ExplorationValues, AdditiveRewards, EpsilonGreedy]
NUM_STATES, NUM_ACTIONS = 6, 3


def fresh(learner, num_states=NUM_STATES, num_actions=NUM_ACTIONS):
    return learner.init(jax.random.key(0), Discrete(num_states), Discrete(num_actions), 0)


@eqx.filter_jit
def act(learner, key, state, observation, exploration):
    return learner.act(key, state, observation, exploration)


def random_steps(num=400, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "observation": rng.integers(NUM_STATES, size=num),
        "action": rng.integers(NUM_ACTIONS, size=num),
        "reward": rng.normal(size=num),
        "next_observation": rng.integers(NUM_STATES, size=num),
        "terminated": rng.uniform(size=num) < 0.2,
        "exploration": rng.uniform(size=num),
    }


@eqx.filter_jit
def learn(learner, state, steps, is_learning=True):
    """Observe steps one after the other."""

    def one(state, step):
        transition = Transition(
            step["observation"].astype(jnp.int32),
            step["action"].astype(jnp.int32),
            step["reward"],
            step["next_observation"].astype(jnp.int32),
            step["terminated"],
        )
        exploration = ExplorationState(step["exploration"], jnp.asarray(is_learning))
        return learner.observe(jax.random.key(1), state, transition, exploration, jnp.int32(0)), None

    return jax.lax.scan(one, state, jax.tree.map(jnp.asarray, steps))[0]


@pytest.mark.parametrize(
    "settings",
    [
        EpsilonGreedy(discount=0.9, initial_q=0.3),
        AdditiveRewards(xi=0.7, discount=0.9, learning_rate=0.2),
        AdditiveRewards(xi=0.7, exploration_reward={"kind": "next-uncertainty"}),
        ExplorationValues(kappa=2.0, ties="first", discount=0.9, initial_q=-0.5, initial_u=0.5),
        ExplorationValues(kappa=2.0, bootstrap="policy", ties="first", initial_u=0.5),
        ExplorationValues(kappa=2.0, bootstrap="max", initial_u=0.5),
        ExplorationValues(kappa=2.0, ties="first", terminal_u="bootstrap", initial_u=0.5),
        ExplorationValues(kappa=2.0, ties="first", exploration_reward={"kind": "next-uncertainty"}),
    ],
    ids=lambda settings: "-".join(
        [settings.kind, *(str(v) for k, v in settings.model_dump(exclude_defaults=True).items())]
    ),
)
def test_the_update_is_the_one_of_plain_numpy(settings):
    learner, steps = build(settings), random_steps()
    state = learn(learner, fresh(learner), steps)
    reward = getattr(settings, "exploration_reward", None)
    expected = QLearning(
        kind=settings.kind,
        num_states=NUM_STATES,
        num_actions=NUM_ACTIONS,
        discount=settings.discount,
        learning_rate=settings.learning_rate,
        weight=float(learner.exploration_weight),
        initial_q=settings.initial_q,
        initial_u=getattr(settings, "initial_u", 0.0),
        reward_kind=reward.kind if reward else "first-visit",
        bootstrap=getattr(settings, "bootstrap", "greedy-q"),
        terminal_u=getattr(settings, "terminal_u", "masked"),
    )
    for s, a, r, s2, end, exploration in zip(*steps.values(), strict=True):
        expected.observe(s, a, r, s2, end, exploration)
    np.testing.assert_allclose(state.q, expected.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.u, expected.u, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(state.visits, expected.counts)
    for s, a in ((0, 0), (5, 2)):
        q, u = eqx.filter_jit(learner.values)(state, jnp.int32(s), jnp.int32(a))
        assert (float(q), float(u)) == (np.asarray(state.q)[s, a], np.asarray(state.u)[s, a])


@pytest.mark.parametrize("schema", LEARNERS)
def test_without_learning_nothing_changes(schema):
    learner = build(schema())
    learned = learn(learner, fresh(learner), random_steps())
    again = learn(learner, learned, random_steps(seed=1), is_learning=False)
    np.testing.assert_array_equal(again.columns, learned.columns)


@pytest.mark.parametrize("schema", LEARNERS)
def test_a_test_acts_greedily(schema):
    learner = build(schema())
    state = learn(learner, fresh(learner), random_steps())
    best = jax.jit(
        jax.vmap(lambda key, s: learner.act(key, state, s, exploring(0.0, False)), in_axes=(0, None))
    )
    for s, q in enumerate(np.asarray(state.q)):
        actions, expected = best(jax.random.split(jax.random.key(s), 50), jnp.int32(s))
        assert set(np.asarray(actions).tolist()) == {int(np.argmax(q))}
        assert np.all(np.asarray(expected) == q.max())


def test_exploration_values_weigh_u_by_kappa_and_balance():
    learner = build(ExplorationValues(kappa=2.0))
    state = eqx.tree_at(
        lambda t: t.columns,
        fresh(learner, 1, 2),
        jnp.asarray([[[1.0, -1.0, 3.0], [0.0, -0.4, 1.0]]]),  # Q, U and visits of two actions
    )
    for exploration, best in ((1.0, 1), (0.5, 0)):  # 1 - 2 < 0 - 0.8, and 1 - 1 > 0 - 0.4
        action, _ = act(learner, jax.random.key(0), state, jnp.int32(0), exploring(exploration))
        assert int(action) == best


@pytest.mark.parametrize("ties", ["random", "first"])
def test_epsilon_greedy_draws_any_action_with_probability_epsilon(ties):
    learner = build(EpsilonGreedy(epsilon=0.4, ties=ties))
    state = eqx.tree_at(lambda t: t.columns, fresh(learner, 1, 4), jnp.zeros((1, 4, 2)).at[0, 2, 0].set(1.0))
    keys = jax.random.split(jax.random.key(0), 10_000)
    draw = jax.jit(jax.vmap(lambda key: learner.act(key, state, jnp.int32(0), exploring(0.5))[0]))
    shares = np.bincount(np.asarray(draw(keys)), minlength=4) / 10_000
    assert shares == pytest.approx([0.05, 0.05, 0.85, 0.05], abs=0.015)


def run_of(env, settings, episodes, **more) -> LearningRun:
    """A run of an environment that has no settings of its own."""
    run = build(
        Learning(env="chain", learner=settings, episodes=episodes, dtype="float64", **more), "float64"
    )
    return eqx.tree_at(lambda r: r.env, run, env)


@eqx.filter_jit
def trained(run: LearningRun, seed=0):
    """The learner's tables after all episodes."""
    carry = run.init(jax.random.key(seed))
    return jax.lax.fori_loop(0, run.max_advances, lambda _, c: run.advance(c)[0], carry).learner


@pytest.mark.parametrize("absorbs", [True, False])
def test_values_are_continued_past_a_time_limit_but_not_past_an_end(absorbs):
    # Absorbing: Q = (0.5, 1). A limit of two steps: Q0 = 0.5 Q1, Q1 = 1 + 0.5 Q0, so Q = (2/3, 4/3).
    env = Loop(reward=jnp.asarray(1.0), absorbs=absorbs)
    settings = EpsilonGreedy(discount=0.5, learning_rate=0.5, block=2)
    q = np.asarray(trained(run_of(env, settings, 120)).q)[:, 0]
    assert q == pytest.approx([0.5, 1.0] if absorbs else [2 / 3, 4 / 3])


def test_q_learning_converges_to_the_exact_values_of_a_stochastic_chain():
    domain = build(Chain(length=5, max_length=5, max_steps=2000))
    probability, to = tables(domain)
    exact = value_iteration(probability, to.observation, to.reward, to.terminated, 0.9)
    settings = EpsilonGreedy(epsilon=1.0, discount=0.9, learning_rate=0.005)
    learned = np.asarray(trained(run_of(domain, settings, 3000)).q)
    np.testing.assert_allclose(learned[:4], exact[:4], atol=0.05)


@pytest.mark.parametrize("which", ["observation_space", "action_space"])
def test_a_continuous_space_is_refused(which):
    box = Box(jnp.zeros(2), jnp.ones(2))
    spaces = {"observation_space": Discrete(2), "action_space": Discrete(2)} | {which: box}
    with pytest.raises(ValueError, match=f"{which}: a tabular learner needs a Discrete space, got a Box"):
        build(EpsilonGreedy()).init(jax.random.key(0), **spaces, capacity=0)


def test_observations_outside_the_table_are_no_error():
    learner = build(ExplorationValues())
    state, outside = fresh(learner), NUM_STATES + 3
    steps = {name: values[:1] for name, values in random_steps().items()} | {
        "observation": np.asarray([outside])
    }
    np.testing.assert_array_equal(learn(learner, state, steps).columns, state.columns)
    assert int(act(learner, jax.random.key(0), state, jnp.int32(outside), exploring())[0]) >= 0
