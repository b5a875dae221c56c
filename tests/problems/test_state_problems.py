"""State problems against their definitions in plain NumPy, and against what is known of them exactly."""

from collections import Counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.problems import kalman
from bojax.problems.pomdp import sub_hunt_values
from tests.protocol.lanes import rounded_products
from tests.reference import state_problems as reference

SMALLEST_P = 1e-4
"""Tests of distributions fail below this p-value: one of 10,000 by chance, and keys are fixed."""


def problem(kind, dtype="float64", **settings):
    return build(kinds("problem")[kind](**settings), dtype)


CONTINUOUS = {
    "vdp-tag": (problem("vdp-tag"), reference.VdpTag()),
    "light-dark": (problem("light-dark"), reference.LightDark()),
    "pomdp-lander": (problem("pomdp-lander"), reference.PomdpLander()),
    "light-dark-nd": (problem("light-dark-nd"), reference.LightDarkNd()),
    "three dimensions, two agents": (
        problem("light-dark-nd", num_dims=3, num_agents=2),
        reference.LightDarkNd(3, 2),
    ),
    "lqg": (problem("lqg"), reference.Lqg()),
}
OBSERVED = CONTINUOUS | {"sub-hunt": (problem("sub-hunt"), reference.SubHunt())}


@eqx.filter_jit
def walks(each, key, count, num_steps):
    """Steps of random walks: states, actions, next states, rewards, terminations and observations."""

    def walk(key):
        start_key, key = jax.random.split(key)

        def advance(state, step):
            action_key, step_key, observe_key = jax.random.split(jax.random.fold_in(key, step), 3)
            action = each.actions.decode(each.actions.sample(action_key))
            following, reward, terminated = each.step(step_key, state, action)
            observation = each.observe(observe_key, state, action, following)
            return following, (state, action, following, reward, terminated, observation)

        return jax.lax.scan(advance, each.initial(start_key), jnp.arange(num_steps, dtype=jnp.uint32))[1]

    found = jax.vmap(walk)(jax.random.split(key, count))
    return [value.reshape(-1, *value.shape[2:]) for value in found]


def near_the_end(define, states):
    """States from which a step may end the episode, which random walks seldom meet."""
    rng = np.random.default_rng(1)
    states = states.copy()
    if isinstance(define, reference.VdpTag):
        states[:, 2:] = states[:, :2] + rng.uniform(-0.7, 0.7, (len(states), 2))
    elif isinstance(define, reference.PomdpLander):
        states[:, :3] = rng.uniform([-16.0, 0.0, -0.55], [16.0, 8.0, 0.55], (len(states), 3))
    elif isinstance(define, reference.LightDarkNd):
        states = np.tile(define.goal, define.num_agents) + rng.normal(scale=0.15, size=states.shape)
    return states


@pytest.mark.parametrize("kind", CONTINUOUS)
def test_a_step_is_the_definition(kind):
    each, define = CONTINUOUS[kind]
    found = walks(each, jax.random.key(0), 60, 2 if kind == "lqg" else 12)
    states, actions = (np.asarray(value) for value in found[:2])
    starts = np.concatenate([states, near_the_end(define, states)])
    scale = 0.1 if isinstance(define, reference.LightDarkNd) else 1.0
    actions = np.concatenate([actions, scale * actions])
    keys = jax.random.split(jax.random.key(1), len(starts))
    step = jax.jit(jax.vmap(each.step))
    following, rewards, ends = (np.asarray(value) for value in step(keys, starts, actions))
    residuals = []
    for state, action, after, reward, ended in zip(starts, actions, following, rewards, ends, strict=True):
        mean, noise = define.step(state, action)
        np.testing.assert_allclose(after[noise == 0], mean[noise == 0], rtol=0, atol=1e-12)
        residuals.append((after - mean)[noise > 0] / noise[noise > 0])
        assert define.reward(state, action, after) == (pytest.approx(reward, abs=1e-9), ended)
    for residual in np.array(residuals).T:
        assert stats.kstest(residual, "norm").pvalue > SMALLEST_P
    assert 0 < np.sum(ends) < len(ends)


@pytest.mark.parametrize("kind", OBSERVED)
def test_an_observation_has_its_density(kind):
    each, define = OBSERVED[kind]
    found = walks(each, jax.random.key(2), 60, 2 if kind == "lqg" else 12)
    states, actions, following, _, _, observations = (np.asarray(value) for value in found)
    density = jax.jit(jax.vmap(each.log_likelihood))
    expected = [define.observation(a, s) for a, s in zip(actions, following, strict=True)]
    means, noises = (np.stack(values) for values in zip(*expected, strict=True))
    for residual in ((observations - means) / noises).T:
        assert stats.kstest(residual, "norm").pvalue > SMALLEST_P
    log_density = [reference.log_density(*values) for values in zip(observations, means, noises, strict=True)]
    np.testing.assert_allclose(density(observations, states, actions, following), log_density, atol=1e-9)
    # The integral of the density, by importance sampling from a wider one.
    wide = np.random.default_rng(3).normal(means, 1.3 * noises, (30, *means.shape))
    proposal = np.array(
        [[reference.log_density(*v) for v in zip(o, means, 1.3 * noises, strict=True)] for o in wide]
    )
    target = jax.jit(jax.vmap(jax.vmap(each.log_likelihood), (0, None, None, None)))
    weights = np.exp(np.asarray(target(wide, states, actions, following)) - proposal).ravel()
    assert abs(weights.mean() - 1.0) < 4.0 * weights.std() / len(weights) ** 0.5
    assert weights.std() / len(weights) ** 0.5 < 0.02


def test_no_move_crosses_a_barrier():
    each = problem("vdp-tag", "float32")
    define = reference.VdpTag()

    @jax.jit
    def paths(key):
        def advance(agent, angle):
            after = each.move(agent, angle)
            return after, (agent, after)

        angle_key, start_key = jax.random.split(key)
        angles = jax.random.uniform(angle_key, (100, 240), jnp.float32, 0.0, 2.0 * jnp.pi)
        starts = jax.random.uniform(start_key, (240, 2), jnp.float32, -1.5, 1.5)
        run = jax.vmap(lambda start, own: jax.lax.scan(advance, start, own)[1], (0, 1))
        return run(starts, angles)

    before, after = (np.asarray(v, np.float64).reshape(-1, 2) for v in paths(jax.random.key(4)))
    assert len(before) == 24_000
    lengths = np.hypot(*(after - before).T)
    stopped = lengths < 0.5 - 1e-5
    assert 1000 < stopped.sum() < 12_000
    crossed = 0
    for start, end in zip(before, after, strict=True):
        for axis in (0, 1):
            if start[axis] * end[axis] < 0.0:
                share = start[axis] / (start[axis] - end[axis])
                place = abs(start[1 - axis] + share * (end[1 - axis] - start[1 - axis]))
                crossed += 0.2 + 1e-5 < place < 3.0 - 1e-5
    assert crossed == 0
    # A move that is not stopped has met no barrier, and one that is stopped has.
    moves = np.where(stopped[:, None], 0.0, after - before)
    assert all(define.crossing(start, move) is None for start, move in zip(before, moves, strict=True))


def test_values_of_light_dark_are_those_of_the_shortest_ways():
    each, define = CONTINUOUS["light-dark"]
    values = define.values()
    found = jax.vmap(each.heuristic_value)(jnp.arange(-60.0, 61.0)[:, None])
    np.testing.assert_allclose(found, [values[s] for s in range(-60, 61)], rtol=1e-12)
    published = {0: 100.0, 1: 94.0, 7: 77.7407, 15: 68.2110, 30: 82.8850}
    for state, value in published.items():
        assert found[60 + state] == pytest.approx(value, abs=1e-4)
    assert np.mean(found[30:91]) == pytest.approx(78.4433, abs=1e-4)


def test_sub_hunt_moves_as_defined():
    each, define = OBSERVED["sub-hunt"]
    step = jax.jit(jax.vmap(each.step, (0, None, None)))
    cases = [
        ((10, 10, 12, 10, 0, 0), 5),  # a kill
        ((10, 10, 12, 10, 0, 1), 5),  # a kill of a target that is aware
        ((10, 10, 12, 11, 1, 1), 5),  # out of reach
        ((10, 19, 5, 18, 0, 0), 0),  # the edges
        ((2, 2, 1, 1, 3, 0), 3),
        ((20, 1, 20, 2, 2, 0), 1),
        ((7, 7, 3, 4, 3, 0), 4),
    ]
    for seed, (state, action) in enumerate(cases):
        keys = jax.random.split(jax.random.key(seed), 2000)
        after, reward, ended = (
            np.asarray(v) for v in step(keys, jnp.asarray(state, float), jnp.full(1, float(action)))
        )
        killed = reward == 100.0
        assert np.all(reward[~killed] == 0.0)
        seen = ["kill" if kill else tuple(map(int, s)) for kill, s in zip(killed, after, strict=True)]
        expected = define.outcomes(state, action)
        counts = Counter(seen)
        assert set(counts) <= set(expected)
        observed = [counts[outcome] for outcome in expected]
        if len(expected) > 1:
            assert stats.chisquare(observed, [2000 * p for p in expected.values()]).pvalue > SMALLEST_P
        assert [define.is_over(outcome) for outcome in seen] == list(ended)


def test_sub_hunt_starts_at_the_edges():
    each, define = OBSERVED["sub-hunt"]
    starts = np.asarray(jax.jit(jax.vmap(each.initial))(jax.random.split(jax.random.key(6), 4000)), int)
    counts = Counter(map(tuple, starts))
    possible = set()
    for place in range(1, 21):
        for direction, target in enumerate([(place, 1), (1, place), (place, 20), (20, place)]):
            possible.add((10, 10, *target, direction, 0))
    assert set(counts) == possible
    assert stats.chisquare(list(counts.values())).pvalue > SMALLEST_P


def test_values_of_sub_hunt_are_those_of_value_iteration():
    each, define = problem("sub-hunt", size=5), reference.SubHunt(5)
    expected = define.values()
    states = np.array(list(expected), float)
    alive = [not define.is_over(state) for state in expected]
    found = np.asarray(jax.vmap(each.values_at)(jnp.asarray(states)))
    np.testing.assert_allclose(found[alive], np.array(list(expected.values()))[alive], atol=1e-9)
    assert np.all(found[np.logical_not(alive)] == 0.0)
    assert each.heuristic_value(jnp.asarray(states[alive][0])) == found[alive][0].max()


def test_values_of_sub_hunt_are_solved_once(monkeypatch):
    solved = []

    def solve(rules):
        solved.append(rules)
        return np.full((4, 4, 4, 2, 6), float(len(solved)))

    monkeypatch.setattr(sub_hunt_values, "_last", {})
    monkeypatch.setattr(sub_hunt_values, "_solve", solve)
    settings = [{}, {"num_particles": 10, "ping_noise": 0.1}, {"kill_probability": 0.5}, {}]
    found = [problem("sub-hunt", size=2, **each).action_values for each in settings]
    # Other settings change the values; the last ones alone are kept.
    assert [np.unique(each).item() for each in found] == [1, 1, 2, 3]


@pytest.mark.parametrize("action", [0, 1, 2])
def test_tiger_is_the_definition(action):
    each = problem("tiger")
    step_keys, observe_keys = (jax.random.split(jax.random.key(seed), (2, 4000)) for seed in (7, 8))
    own = jnp.full(1, float(action))
    for side in (0, 1):
        state = jnp.full(1, float(side))
        following, reward, ended = jax.vmap(lambda k, s=state: each.step(k, s, own))(step_keys[side])
        assert not np.any(ended)
        assert set(np.asarray(reward)) == {-1.0 if action == 0 else -100.0 if action == side + 1 else 10.0}
        heard = jax.vmap(lambda k, s=state: each.observe(k, s, own, s))(observe_keys[side])[:, 0]
        right = float(np.mean(heard == side))
        expected = 0.85 if action == 0 else 0.5
        assert abs(right - expected) < 4.0 * (expected * (1 - expected) / 4000) ** 0.5
        if action == 0:
            assert np.all(following == side)
        else:
            assert abs(np.mean(following) - 0.5) < 4.0 * 0.5 / 4000**0.5
        densities = [np.exp(each.log_likelihood(jnp.full(1, o), state, own, state)) for o in (0.0, 1.0)]
        assert sum(densities) == pytest.approx(1.0)
        assert densities[side] == pytest.approx(expected)


def test_the_value_of_tiger_is_that_of_dynamic_programming():
    n, value, opens = reference.tiger_values(3000)
    assert [value[n == i].item() for i in (0, 1, 2)] == pytest.approx([19.371368, 21.4435, 25.0807], abs=1e-4)
    assert set(n[~opens]) == {-1, 0, 1}
    assert reference.tiger_values(100)[1][n == 0] == pytest.approx(19.247365, abs=1e-5)
    seen = problem("tiger").heuristic_value(jnp.zeros(1))  # the treasure, 100 times
    assert float(seen) == pytest.approx(np.sum(10.0 * 0.95 ** np.arange(100)))
    returns = np.asarray(tiger_returns(problem("tiger"), jax.random.key(8), 20_000))
    assert abs(returns.mean() - 19.247365) < 3.0 * returns.std() / len(returns) ** 0.5


@eqx.filter_jit
def tiger_returns(each, key, count):
    """Returns of the best policy: the belief is exact, by the problem's likelihood of both states."""
    both = jnp.asarray([[0.0], [1.0]])

    def run(key):
        start_key, key = jax.random.split(key)

        def advance(carry, step):
            state, right = carry
            # Heard twice more on one side than on the other.
            odds = jnp.log(right / (1.0 - right)) / jnp.log(0.85 / 0.15)
            action = jnp.where(odds > 1.5, 1.0, jnp.where(odds < -1.5, 2.0, 0.0))[None]
            step_key, observe_key = jax.random.split(jax.random.fold_in(key, step))
            following, reward, _ = each.step(step_key, state, action)
            heard = each.observe(observe_key, state, action, following)
            prior = jnp.where(action[0] == 0.0, jnp.stack([1.0 - right, right]), 0.5)
            likelihood = jax.vmap(lambda s: each.log_likelihood(heard, s, action, s))(both)
            posterior = prior * jnp.exp(likelihood)
            return (following, posterior[1] / jnp.sum(posterior)), reward

        start = (each.initial(start_key), jnp.asarray(0.5))
        rewards = jax.lax.scan(advance, start, jnp.arange(each.max_steps, dtype=jnp.uint32))[1]
        return jnp.sum(rewards * each.discount ** jnp.arange(float(each.max_steps)))

    return jax.vmap(run)(jax.random.split(key, count))


def test_kalman_and_riccati_reach_the_exact_cost_of_lqg():
    each = problem("lqg")
    eye = np.eye(2)
    gains, _ = reference.riccati(eye, eye, eye, eye, 2)
    np.testing.assert_allclose(-gains[0] @ np.asarray(each.initial_mean), [6.0, -6.0], atol=1e-12)
    np.testing.assert_allclose(gains[1], 0.5 * eye, atol=1e-12)
    exact = reference.lqg_cost(np.array([-10.0, 10.0]), 0.01 * eye, 0.01 * eye, 0.01 * eye, 2)
    assert exact == pytest.approx(320.1067, abs=1e-4)

    @jax.jit
    def costs(keys):
        def run(key):
            keys = jax.random.split(key, 5)
            state, belief = each.initial(keys[0]), each.gaussian_prior
            total = jnp.zeros(())
            for t in range(2):
                action = -jnp.asarray(gains[t]) @ belief.mean
                following, reward, ended = each.step(keys[1 + 2 * t], state, action)
                observation = each.observe(keys[2 + 2 * t], state, action, following)
                belief = kalman.update(each.model, belief, action, observation)
                state, total = following, total - reward
            return total, ended

        return jax.vmap(run)(keys)

    total, ended = (np.asarray(v) for v in costs(jax.random.split(jax.random.key(9), 20_000)))
    assert np.all(ended)
    assert abs(total.mean() - exact) < 3.0 * total.std() / len(total) ** 0.5


STATE_PROBLEMS = [
    kind for kind, each in kinds("problem").items() if each.__module__.endswith("pomdp.settings")
]


@pytest.mark.parametrize("kind", [*STATE_PROBLEMS, "pomdp-lander, gaussian"])
def test_no_product_is_rounded_on_a_gpu(kind):
    name, _, belief_update = kind.partition(", ")
    each = problem(name, "float32", **({"belief_update": belief_update} if belief_update else {}))

    def one_step(key):
        keys = jax.random.split(key, 5)
        world = each.reset(keys[0])
        belief = each.prior(keys[1], world, 8)
        action = each.actions.decode(each.actions.sample(keys[2]))
        world, observation, events = each.execute(keys[3], world, action)
        belief = each.update(belief, action, observation, keys[4])
        return world, events, belief, belief.mean, belief.covariance

    assert not rounded_products(jax.make_jaxpr(one_step)(jax.random.key(0)).jaxpr)
