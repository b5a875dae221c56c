"""TRPO: the Fisher matrix of a small policy, the step against an exact solution, and what a step promises."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy import special

from bojax.envs.spaces import Box, Discrete
from bojax.learning.networks import Categorical, Gaussian, PolicyNetwork
from bojax.learning.trpo import TRPO, Samples

SPACES = {"continuous": Box(-jnp.ones(2), jnp.ones(2)), "discrete": Discrete(3)}
NUM = 40
each_space = pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)


def trpo(**settings):
    settings = {"max_kl": 0.01, "damping": 1e-5, "backtrack_ratio": 0.8} | settings
    sizes = {name: settings.pop(name, 15) for name in ("cg_steps", "backtracks")}
    return TRPO(**{name: jnp.asarray(value) for name, value in settings.items()}, **sizes)


def problem(space, seed=0, hidden=(4,)):
    """A policy, and actions that it drew; the last rows are not valid."""
    return _drawn(space, jax.random.key(seed), hidden)


@eqx.filter_jit
def _drawn(space, key, hidden):
    keys = jax.random.split(key, 4)
    policy = PolicyNetwork.draw(keys[0], 3, hidden, space, jnp.asarray(0.7))
    inputs = jax.random.normal(keys[1], (NUM, 3))
    actions = jax.vmap(lambda key, x: policy(x).sample(key))(jax.random.split(keys[2], NUM), inputs)
    valid = jnp.arange(NUM) < NUM - 7
    return policy, Samples(inputs, actions, jax.random.normal(keys[3], (NUM,)), valid)


def fisher_matrix(policy, samples):
    """The mean of J'MJ over the valid rows; M is the metric of the distribution in its own parameters."""
    distributions, jacobians = jax.device_get(_linearised(policy, samples.inputs))
    metrics = []
    if isinstance(distributions, Gaussian):  # of the mean and the logarithm of the deviation
        for log_deviation in distributions.log_deviation:
            precision = np.exp(-2 * log_deviation)
            metrics.append(np.diag(np.append(precision, np.full(len(precision), 2.0))))
    else:
        for p in special.softmax(distributions.logits, axis=1):
            metrics.append(np.diag(p) - np.outer(p, p))
    rows = np.flatnonzero(samples.is_valid)
    return np.mean([jacobians[row].T @ metrics[row] @ jacobians[row] for row in rows], axis=0)


@eqx.filter_jit
def _linearised(policy, inputs):
    """The distribution in each row, and the derivatives of its parameters by those of the policy."""
    flat, unravel = ravel_pytree(policy)

    def parameters(theta, x):
        return jnp.concatenate(jax.tree.leaves(unravel(theta)(x)))

    return jax.vmap(policy)(inputs), jax.vmap(jax.jacobian(parameters), (None, 0))(flat, inputs)


@each_space
def test_fisher_products_are_those_of_the_explicit_matrix(space):
    policy, samples = problem(space)
    flat, unravel = ravel_pytree(policy)
    vector = jax.random.normal(jax.random.key(9), flat.shape)
    product = eqx.filter_jit(trpo().fisher_product)(policy, samples, unravel(vector))
    expected = fisher_matrix(policy, samples) @ np.asarray(vector)
    np.testing.assert_allclose(ravel_pytree(product)[0], expected, atol=1e-12 * np.abs(expected).max())


@each_space
def test_the_first_attempt_is_the_natural_gradient_at_the_bound(space):
    policy, samples = problem(space)
    settings = trpo(max_kl=1e-6, damping=1e-3, cg_steps=200)  # small: the quadratic model is exact enough
    flat, _ = ravel_pytree(policy)
    gradient = jax.jit(jax.grad(settings.surrogate, argnums=1))(policy, policy, samples)
    matrix = fisher_matrix(policy, samples) + 1e-3 * np.eye(len(flat))
    direction = np.linalg.solve(matrix, np.asarray(ravel_pytree(gradient)[0]))
    step = direction * np.sqrt(2e-6 / (direction @ matrix @ direction))
    new = eqx.filter_jit(settings.improved)(policy, samples, jnp.asarray(True))
    change = np.asarray(ravel_pytree(new)[0] - flat)
    factor = change @ step / (step @ step)
    np.testing.assert_allclose(change, factor * step, atol=1e-3 * np.abs(step).max())
    attempts = np.log(factor) / np.log(0.8)
    assert -0.01 < attempts < 1.01 and abs(attempts - round(attempts)) < 0.01


@each_space
@pytest.mark.parametrize("seed", range(5))
def test_a_step_improves_the_surrogate_within_the_bound(space, seed):
    policy, samples = problem(space, seed, hidden=(8, 4))
    settings = trpo(cg_steps=10)
    new = eqx.filter_jit(settings.improved)(policy, samples, jnp.asarray(True))
    mean_kl, surrogate = eqx.filter_jit(settings.mean_kl), eqx.filter_jit(settings.surrogate)
    assert float(mean_kl(policy, policy, samples)) == pytest.approx(0.0, abs=1e-15)
    assert 0.002 < float(mean_kl(policy, new, samples)) <= 0.01
    assert surrogate(policy, new, samples) > surrogate(policy, policy, samples)


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@each_space
def test_only_valid_rows_and_advantages_of_active_lanes_move_the_policy(space):
    policy, samples = problem(space)
    valid = samples.is_valid
    others = jnp.where(valid[:, None], samples.inputs, 50.0), jnp.where(valid, samples.advantages, 1e6)
    spoilt = eqx.tree_at(lambda s: (s.inputs, s.advantages), samples, others)
    none = eqx.tree_at(lambda s: s.advantages, samples, jnp.zeros(NUM))
    improved, yes = eqx.filter_jit(trpo().improved), jnp.asarray(True)
    after = improved(policy, samples, yes)
    assert not same(after, policy) and same(after, improved(policy, spoilt, yes))
    assert same(improved(policy, none, yes), policy)
    assert same(improved(policy, samples, ~yes), policy)


def test_densities_probabilities_and_divergences():
    gaussian = Gaussian(jnp.asarray([0.3, -1.0]), jnp.log(jnp.asarray([0.5, 2.0])))
    other = Gaussian(jnp.asarray([0.0, 1.0]), jnp.log(jnp.asarray([1.5, 1.0])))
    draws = jax.vmap(gaussian.sample)(jax.random.split(jax.random.key(0), 100_000))
    np.testing.assert_allclose(jnp.mean(draws, 0), gaussian.mean, atol=0.03)
    np.testing.assert_allclose(jnp.std(draws, 0), [0.5, 2.0], rtol=0.01)
    ratio = jax.vmap(gaussian.log_probability)(draws) - jax.vmap(other.log_probability)(draws)
    np.testing.assert_allclose(gaussian.kl(other), jnp.mean(ratio), rtol=0.03)
    x = np.array([1.0, 0.5])
    z = (x - [0.3, -1.0]) / [0.5, 2.0]
    expected = np.prod(np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) / [0.5, 2.0])
    np.testing.assert_allclose(jnp.exp(gaussian.log_probability(jnp.asarray(x))), expected, rtol=1e-12)

    p, q = np.array([0.2, 0.5, 0.3]), np.array([0.6, 0.3, 0.1])
    categorical = Categorical(jnp.log(jnp.asarray(p)) + 3.0)
    counts = np.bincount(
        jax.vmap(categorical.sample)(jax.random.split(jax.random.key(1), 20_000)), minlength=3
    )
    np.testing.assert_allclose(counts / 20_000, p, atol=0.015)
    assert int(categorical.mode()) == 1
    np.testing.assert_allclose(jnp.exp(categorical.log_probability(jnp.int32(2))), 0.3, rtol=1e-12)
    divergence = categorical.kl(Categorical(jnp.log(jnp.asarray(q))))
    np.testing.assert_allclose(divergence, np.sum(p * np.log(p / q)), rtol=1e-12)
