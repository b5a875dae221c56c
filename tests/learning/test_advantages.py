"""Returns, advantages and their baseline, against loops over paths in plain NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.learning import advantages
from bojax.learning.advantages import LinearBaseline
from tests.reference import vime as reference

discounted_sums, td_errors = jax.jit(advantages.discounted_sums), jax.jit(advantages.td_errors)
fit, predict = eqx.filter_jit(LinearBaseline.fit), eqx.filter_jit(LinearBaseline.predict)

LENGTHS = (5, 1, 12, 7)


def paths(seed=0):
    """Numbers of some paths one after the other, where each starts, and which are the last of a path."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(LENGTHS)
    is_last = np.isin(np.arange(ends[-1]), ends - 1)
    return rng.normal(size=(2, ends[-1])), ends[:-1], is_last


@pytest.mark.parametrize("factor", [0.0, 0.9, 1.0])
def test_sums_of_a_path_are_those_of_a_loop(factor):
    (rewards, _), starts, is_last = paths()
    sums = discounted_sums(jnp.asarray(rewards), jnp.asarray(is_last), jnp.asarray(factor))
    expected = [reference.returns(path, factor) for path in np.split(rewards, starts)]
    np.testing.assert_allclose(sums, np.concatenate(expected), atol=1e-12)


@pytest.mark.parametrize("trace_decay", [1.0, 0.7, 0.0])
def test_advantages_are_those_of_a_loop(trace_decay):
    (rewards, values), starts, is_last = paths()
    errors = td_errors(*(jnp.asarray(x) for x in (rewards, values, is_last)), jnp.asarray(0.9))
    gains = discounted_sums(errors, jnp.asarray(is_last), jnp.asarray(0.9 * trace_decay))
    expected = [
        reference.advantages(r, v, 0.9, trace_decay)
        for r, v in zip(np.split(rewards, starts), np.split(values, starts), strict=True)
    ]
    np.testing.assert_allclose(gains, np.concatenate(expected), atol=1e-12)


def baseline_problem(seed=0):
    rng = np.random.default_rng(seed)
    observations = rng.normal(size=(sum(LENGTHS), 2)) * [1.0, 6.0]
    steps = np.concatenate([np.arange(length) for length in LENGTHS])
    return observations, steps, rng.normal(size=sum(LENGTHS)) + 3.0


def test_the_baseline_is_the_least_squares_fit():
    observations, steps, returns = baseline_problem()
    valid = np.arange(len(steps)) < len(steps) - LENGTHS[-1]
    arrays = (jnp.asarray(x) for x in (observations, steps.astype(np.int32), returns, valid))
    baseline = fit(*arrays)
    features = np.vstack(
        [reference.baseline_features(o) for o in np.split(observations, np.cumsum(LENGTHS)[:-1])]
    )
    chosen, _, _, _ = np.linalg.lstsq(features[valid], returns[valid], rcond=None)
    predicted = predict(baseline, jnp.asarray(observations), jnp.asarray(steps, jnp.int32))
    np.testing.assert_allclose(predicted, features @ np.asarray(baseline.weights), atol=1e-9)
    least = np.mean((features[valid] @ chosen - returns[valid]) ** 2)
    error = np.mean((np.asarray(predicted)[valid] - returns[valid]) ** 2)
    assert least <= error < 1.01 * least


def test_the_baseline_in_single_precision_with_features_that_depend_on_each_other():
    angle = np.linspace(0.0, 6.0, 2000)
    observations = jnp.asarray(np.c_[np.cos(angle), np.sin(angle)], jnp.float32)  # the squares add to 1
    steps, valid = jnp.arange(2000, dtype=jnp.int32) % 500, jnp.ones(2000, bool)
    returns = observations[:, 0] + 0.5 * observations[:, 1] ** 2 - steps.astype(jnp.float32) / 500.0
    baseline = fit(observations, steps, returns, valid)
    assert baseline.weights.dtype == jnp.float32
    np.testing.assert_allclose(predict(baseline, observations, steps), returns, atol=2e-2)
