"""DORA and its tile coding against plain NumPy, its counters, policies and stable logarithms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning.actions import grid_actions, nearest_action
from bojax.learning.base import Episode, Transition
from bojax.learning.dora import E, Q, log_softplus
from bojax.learning.settings import DORA as Settings
from bojax.learning.tile_coding import TileTable, hashes_of, tiles, tuple_hash
from tests.learning.probes import exploring
from tests.reference import dora as reference
from tests.tiers import by_tier

OBSERVATIONS = Box(jnp.asarray([-1.2, -0.07]), jnp.asarray([0.6, 0.07]))
ACTIONS = Box(jnp.asarray([-1.0]), jnp.asarray([1.0]))
NUM_ACTIONS = 3


def walk(num=2000, seed=0):
    """A random walk through the bounds and somewhat beyond them."""
    rng = np.random.default_rng(seed)
    steps = np.clip(np.cumsum(rng.normal(size=(num, 2)) * 0.15, axis=0), -30, 30)
    unit = np.abs((steps + 0.5) % 2.0 - 1.0) * 1.2 - 0.1
    return np.asarray(OBSERVATIONS.low) + unit * np.asarray(OBSERVATIONS.high - OBSERVATIONS.low)


def transitions(num=400, seed=0):
    rng = np.random.default_rng(seed)
    states = walk(num + 1, seed)
    return {
        "observation": states[:-1],
        "action": rng.integers(NUM_ACTIONS, size=num),
        "reward": rng.normal(size=num),
        "next_observation": states[1:],
        "terminated": rng.uniform(size=num) < 0.05,
    }


def make(**settings):
    learner = build(Settings(**settings))
    return learner, eqx.filter_jit(learner.init)(jax.random.key(1), OBSERVATIONS, ACTIONS, 0)


@eqx.filter_jit
def learn(learner, state, steps, exploration):
    """Observe transitions one after the other: the last state, and the next action after each of them."""

    def one(state, step):
        number = step.pop("number")
        transition = Transition(**(step | {"action": state.actions[step["action"]]}))
        state = learner.observe(jax.random.key(number), state, transition, exploration, jnp.int32(0))
        return state, state.next_action

    steps = {name: jnp.asarray(rows) for name, rows in steps.items()}
    numbers = jnp.arange(len(steps["reward"]), dtype=jnp.int32)
    return jax.lax.scan(one, state, steps | {"number": numbers})


@pytest.mark.parametrize("num_dims", by_tier([1, 2, 6], normal=[6]))
@pytest.mark.parametrize("size", [150, 2048])
def test_tiles_have_the_indices_of_a_dictionary_even_when_it_is_full(num_dims, size):
    rng = np.random.default_rng(num_dims)
    points = np.cumsum(rng.normal(size=(3000, num_dims)) * 0.2, axis=0)
    coder = reference.TileCoder(8, size)
    expected = np.array([[coder(x, a) for a in range(NUM_ACTIONS)] for x in points])
    table = jax.jit(lambda: TileTable.empty(size, 8, NUM_ACTIONS))()
    look_up = jax.jit(lambda table, points: jax.lax.scan(lambda t, x: t.look_up(tiles(x, 8)), table, points))
    table, found = look_up(table, jnp.asarray(points))
    np.testing.assert_array_equal(found, expected)
    assert int(table.num_used) == len(coder.indices)
    assert coder.num_hashed > 1000 or size > 150


def test_the_hash_is_that_of_python_integers_and_even():
    rng = np.random.default_rng(0)
    columns = rng.integers(-50, 50, size=(4, 20_000)).astype(np.int32)
    found = np.asarray(jax.jit(tuple_hash)(list(columns)))
    assert found[:500].tolist() == [reference.tuple_hash(row) for row in columns.T[:500].tolist()]
    different = {tuple(row) for row in columns.T.tolist()}
    counts = np.bincount(np.unique(found) % 64, minlength=64)
    # 20,000 hashes in 64 bins: 312 in each, with a standard deviation of 18.
    assert len(np.unique(found)) == len(different)
    assert 220 < counts.min() and counts.max() < 405


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"policy": "epsilon-greedy", "xi": 0.0},
        {"derivative": "at-logit", "learning_rate": 0.8, "e_discount": 0.7},
        {"num_indices": 90, "discount": 0.9},
        {"e_values": "linear", "e_discount": 0.5, "num_tilings": 4},
    ],
    ids=lambda settings: "-".join(str(value) for value in settings.values()) or "default",
)
def test_the_updates_are_those_of_plain_numpy(settings):
    learner, state = make(**settings)
    steps = transitions()
    after, next_actions = learn(learner, state, steps, exploring(0.8))
    names = {"discount", "e_discount", "learning_rate", "e_learning_rate", "xi", "e_values", "derivative"}
    expected = reference.DORA(
        reference.TileCoder(learner.num_tilings, learner.num_indices),
        np.asarray(learner.num_tilings / (OBSERVATIONS.high - OBSERVATIONS.low)),
        NUM_ACTIONS,
        np.array(state.weights[:, Q]),
        **{name: value for name, value in settings.items() if name in names},
    )
    for row in zip(*steps.values(), np.asarray(next_actions), strict=True):
        expected.observe(*row, scale=0.8)
    np.testing.assert_allclose(after.weights[:, Q], expected.w_q, rtol=0, atol=1e-10)
    np.testing.assert_allclose(after.weights[:, E], expected.w_e, rtol=0, atol=1e-10)
    assert np.abs(expected.w_e).max() > 0.01  # E has moved by far more than the tolerance
    assert (np.asarray(next_actions)[steps["terminated"]] == -1).all()


@pytest.mark.parametrize("e_discount", [0.0, 0.9])
def test_counters_on_a_table_are_visit_counts_if_nothing_is_discounted(e_discount):
    learner = build(Settings(e_values="linear", num_tilings=1, e_discount=e_discount, num_indices=12))
    state = eqx.filter_jit(learner.init)(jax.random.key(1), Discrete(6), Discrete(2), 0)
    rng = np.random.default_rng(3)
    steps = {
        "observation": rng.integers(6, size=60).astype(np.int32),
        "action": rng.integers(2, size=60).astype(np.int32),
        "reward": np.zeros(60),
        "next_observation": rng.integers(6, size=60).astype(np.int32),
        "terminated": np.zeros(60, bool),
    }
    after, _ = learn(learner, state, steps, exploring())
    visits = np.zeros((6, 2))
    np.add.at(visits, (steps["observation"], steps["action"]), 1)
    pairs = np.meshgrid(np.arange(6, dtype=np.int32), np.arange(2, dtype=np.int32), indexing="ij")
    _, u = jax.jit(jax.vmap(jax.vmap(lambda s, a: learner.values(after, s, a))))(*pairs)
    counters = -np.exp(-np.asarray(u)) / np.log1p(-learner.e_learning_rate)  # log E over log(1 - alpha_E)
    if e_discount == 0.0:
        np.testing.assert_allclose(counters, visits, atol=1e-9)
    else:  # a pair counts less while what follows it is new
        assert np.all(counters < visits) and np.all(counters[visits > 0] > 0.0)


def test_log_of_minus_log_e_is_stable():
    for dtype, smallest in ((jnp.float32, 1e-7), (jnp.float64, 1e-14)):
        logits = jnp.asarray([-500.0, -30.0, -1.0, 0.0, 1.0, 19.9, 20.1, 60.0, 500.0], dtype)
        found = jax.jit(lambda logits: log_softplus(-logits))(logits)
        with np.errstate(over="ignore"):
            exact = [np.log(np.log1p(np.exp(-np.longdouble(z)))) if z > -100 else np.log(-z) for z in logits]
        np.testing.assert_allclose(found, np.asarray(exact, float), rtol=10 * smallest)


def policies_of(state, **settings):
    """The actions that 400 calls choose in a state with Q = (1, 0, 1) and logits (1, 0, 1) of E."""
    learner = build(Settings(**settings))
    observation = jnp.asarray([0.1, 0.01])

    @jax.jit
    def look_up(state):
        return state.table.look_up(tiles(state.scale * observation, learner.num_tilings))

    table, index = look_up(state)
    weights = np.zeros_like(state.weights)
    weights[np.asarray(index)[[0, 2]]] = 1 / 8
    state = eqx.tree_at(lambda s: (s.table, s.weights), state, (table, jnp.asarray(weights)))

    def act(key, scale):
        action, _ = learner.act(key, state, observation, exploring(scale))
        return nearest_action(state.actions, action)

    run = jax.jit(jax.vmap(act, in_axes=(0, None)))
    return {s: np.bincount(run(jax.random.split(jax.random.key(3), 400), s), minlength=3) for s in (1.0, 0.0)}


def test_lll_prefers_few_visits_and_breaks_ties_at_random():
    _, state = make()
    # Scores: 1 - T log(-log s(1)) = 1 + 1.16 T, and -T log(log 2) = 0.37 T; E falls with visits.
    chosen = policies_of(state, temperature=0.5)
    for counts in chosen.values():
        assert counts[1] == 0 and 150 < counts[0] < 250


def test_epsilon_greedy_takes_the_first_of_the_best():
    _, state = make()
    chosen = policies_of(state, policy="epsilon-greedy", epsilon=0.3)
    assert chosen[0.0].tolist() == [400, 0, 0]
    # A third of 30% each: 40 of 400, with a standard deviation of 6.
    assert all(15 < number < 65 for number in chosen[1.0][1:])


def test_the_action_chosen_before_the_update_is_taken():
    learner, state = make()
    steps = {name: rows[:1] for name, rows in transitions(1).items()} | {"terminated": np.zeros(1, bool)}
    after, (next_action,) = learn(learner, state, steps, exploring())
    observation = jnp.asarray(steps["next_observation"][0])
    act, values = eqx.filter_jit(learner.act), eqx.filter_jit(learner.values)
    for seed in range(5):
        action, _ = act(jax.random.key(seed), after, observation, exploring())
        np.testing.assert_array_equal(action, state.actions[next_action])
    for chosen in range(NUM_ACTIONS):  # a test does not take it: the first of the best, or another
        held = eqx.tree_at(lambda s: s.next_action, after, jnp.asarray(chosen, jnp.int32))
        actions = [
            act(jax.random.key(0), held, observation, exploring(*each))[0] for each in ((), (0.0, False))
        ]
        np.testing.assert_array_equal(actions[0], state.actions[chosen])
        best = max(float(values(after, observation, a)[0]) for a in np.asarray(state.actions))
        np.testing.assert_allclose(values(after, observation, actions[1])[0], best, rtol=1e-12)
    transition = Transition(**{name: jnp.asarray(rows) for name, rows in steps.items()})
    episode = Episode(transition, jnp.asarray(1, jnp.int32))
    ended = eqx.filter_jit(learner.end_episode)(jax.random.key(0), after, episode, exploring())
    assert int(ended.next_action) == -1


def test_without_learning_nothing_changes():
    learner, state = make()
    learned, _ = learn(learner, state, transitions(), exploring())
    again, _ = learn(learner, learned, transitions(seed=1), exploring(is_learning=False))
    assert eqx.tree_equal(*jax.device_get((again, learned)))


def test_both_policies_are_one_program():
    variants = [{}, {"policy": "epsilon-greedy"}, {"derivative": "at-logit"}, {"e_values": "linear"}]
    assert len({jax.tree.structure(build(Settings(**variant))) for variant in variants}) == 1


def test_the_grid_has_every_combination_of_even_values():
    box = Box(jnp.asarray([-1.0, 0.0]), jnp.asarray([1.0, 4.0]))
    grid = grid_actions(3, box)
    assert grid.tolist() == [[x, y] for x in (-1.0, 0.0, 1.0) for y in (0.0, 2.0, 4.0)]
    assert [int(nearest_action(grid, action)) for action in grid] == list(range(9))
    assert grid_actions(3, Discrete(4)).tolist() == [0, 1, 2, 3]


def test_unbounded_observations_are_refused():
    with pytest.raises(ValueError, match="finite bounds"):
        build(Settings()).check_spaces(Box(jnp.asarray([-jnp.inf]), jnp.asarray([1.0])), ACTIONS)


def test_tiles_near_each_other_share_one_hash_but_not_both():
    shape = (8, *6 * [14])
    near = np.stack(np.unravel_index(57 * np.arange(2**20), shape), axis=1) - np.array([0, *6 * [2]])
    hashes = np.asarray(jax.jit(hashes_of)(jnp.asarray(near, jnp.int32)))
    assert len(np.unique(hashes[:, 0])) < len(hashes)
    assert len(np.unique(hashes.astype(np.uint64) @ np.array([1, 2**32], np.uint64))) == len(hashes)
