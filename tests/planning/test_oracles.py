"""Policies without search on beliefs of a few particles, by hand and in plain NumPy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.planning import oracles
from bojax.planning.leaf_values import Rollout
from bojax.planning.pft import BeliefRollout
from bojax.problems.particles import Particles
from tests.reference import state_problems as reference
from tests.refusals import assert_refused

VDP = build(kinds("problem")["vdp-tag"]())
LIGHT_DARK = build(kinds("problem")["light-dark"]())
MOVES = (-10.0, -1.0, 0.0, 1.0, 10.0)


def belief(states, weights=None):
    """A belief; without weights, they are equal."""
    count = len(states)
    weights = jnp.full(count, 1.0 / count) if weights is None else jnp.asarray(weights)
    return Particles(jnp.asarray(states, float), jnp.log(weights), jnp.zeros(count, bool))


@eqx.filter_jit
def act(policy, problem, belief):
    """The action of a policy, which draws nothing."""
    return policy(problem, jax.random.key(0), belief)


def towards(state):
    """Angle from the agent to the target's next position."""
    target = reference.VdpTag().step(np.array(state), (0.0, 0.0))[0][2:]
    return np.arctan2(*(target - state[:2])[::-1]) % (2.0 * np.pi)


def test_to_next_ml_goes_to_the_target_of_a_random_particle():
    states = np.random.default_rng(0).uniform(-3.0, 3.0, (4, 4))
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    of_key = jax.jit(jax.vmap(lambda key: oracles.to_next_ml(VDP, key, belief(states, weights))))
    actions = np.asarray(of_key(jax.random.split(jax.random.key(0), 2000)))
    assert np.all(actions[:, 1] == 0.0)
    gaps = np.abs(actions[:, :1] - [towards(state) for state in states])
    assert np.all(gaps.min(axis=1) < 1e-9)
    shares = np.bincount(gaps.argmin(axis=1), minlength=4) / 2000
    assert np.all(np.abs(shares - weights) < 4.0 * np.sqrt(weights * (1.0 - weights) / 2000))


@pytest.mark.parametrize("spread", [0.001, 0.08, 0.12, 1.0])
def test_manage_uncertainty_looks_if_the_target_is_uncertain(spread):
    rng = np.random.default_rng(1)
    states = np.column_stack([np.full((500, 2), 0.3), rng.normal([1.0, -2.0], spread, (500, 2))])
    action = act(oracles.manage_uncertainty, VDP, belief(states))
    assert action[0] == pytest.approx(towards(states.mean(axis=0)), abs=1e-9)
    deviation = np.sqrt(np.linalg.det(np.cov(states[:, 2:].T, ddof=0)))
    assert action[1] == float(deviation > 0.01)
    without_look = act(oracles.to_next_mean, VDP, belief(states))
    assert without_look[0] == action[0] and without_look[1] == 0.0


def test_qmdp_takes_the_best_mean_value():
    values = reference.LightDark().values()
    rng = np.random.default_rng(2)
    for _ in range(30):
        states = rng.integers(-30, 31) + rng.integers(-4, 5, size=6)
        weights = rng.dirichlet(np.ones(6))
        expected = {}
        for move in MOVES:
            after = [0.95 * values[max(-60, min(60, s + move))] - 1.0 for s in states]
            stopped = [100.0 if s == 0 else -100.0 for s in states]
            expected[move] = weights @ (after if move else stopped)
        action = act(oracles.qmdp, LIGHT_DARK, belief(states[:, None], weights))
        assert expected[action.item()] == pytest.approx(max(expected.values()), abs=1e-9)


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ([-20, -24], 10.0),
        ([0, 1], 1.0),
        ([0, 0.5], 1.0),
        ([1, -1], 10.0),  # a distance of exactly 10
        ([20, 20.5], -10.0),
        ([12, 13], -1.0),
        ([9, 11], -1.0),  # the mean is in the light
        ([10.0, 10.0], -10.0),  # known: the way to 0
        ([0, 0], 0.0),
        ([0.0, 0.15], 0.0),  # a deviation of 0.075
    ],
)
def test_localise_first(states, expected):
    action = act(oracles.localise_first, LIGHT_DARK, belief(np.array(states)[:, None]))
    assert action.item() == expected


def test_aside_first():
    for count, expected in ((9, 10.0), (10, 0.0)):
        states = np.array([0.0] * count + [30.0] * (10 - count))[:, None]
        assert act(oracles.aside_first, LIGHT_DARK, belief(states)).item() == expected


def test_ping_first():
    problem = build(kinds("problem")["sub-hunt"](size=5))
    table = jnp.zeros((5, 5, 5, 5, 4, 2, 6)).at[2, 2, 3, 3, 0, :, 5].set(1.0)
    problem = dataclasses.replace(problem, action_values=table)
    for aware, expected in ((0.0, 4.0), (1.0, 5.0)):
        states = np.array([[3.0, 3.0, 4.0, 4.0, 0.0, aware]] * 3)
        assert act(oracles.ping_first, problem, belief(states)).item() == expected


def test_slow_down():
    problem = build(kinds("problem")["pomdp-lander"]())
    states = np.array([[0.0, 30.0, 0.0, 2.0, -10.0, 0.0], [0.0, 30.0, 0.0, 4.0, -20.0, 0.0]])
    np.testing.assert_allclose(act(oracles.slow_down, problem, belief(states)), [-1.5, 7.5, 0.0])
    states[:, 3:5] = [100.0, 50.0]
    np.testing.assert_allclose(act(oracles.slow_down, problem, belief(states)), [-5.0, 0.0, 0.0])


def test_names_of_no_part_are_refused():
    assert_refused(
        (
            (lambda: Rollout("qmpd"), '^policy: got "qmpd"; allowed: to-next-ml, .*, qmdp,'),
            (
                lambda: BeliefRollout("seen", "qmdp"),
                '^belief_step: got "seen"; allowed: observed, published$',
            ),
        )
    )
