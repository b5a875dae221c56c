"""The Bayesian network against plain NumPy, and its information gain against KL divergences."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.models.bayesian_network import BayesianNetwork
from tests.reference.vime import Model

PRIOR, LIKELIHOOD, BATCHES = 0.5, 0.7, 5.0


def network_and_model(seed=0):
    """A network after some changes of its deviations, and the same in NumPy."""
    network = changed_network(jax.random.key(seed))
    return network, Model([np.array(x) for x in jax.tree.leaves(network)], PRIOR, LIKELIHOOD, BATCHES)


@jax.jit
def changed_network(key):
    key, key_rho = jax.random.split(key)
    network = BayesianNetwork.draw(key, (3, 5, 2), jnp.asarray(PRIOR))
    leaves, structure = jax.tree.flatten(network)
    keys = jax.random.split(key_rho, len(leaves))
    leaves = [x + 0.3 * jax.random.normal(k, x.shape) for x, k in zip(leaves, keys, strict=True)]
    return jax.tree.unflatten(structure, leaves)


@partial(jax.jit, static_argnames="num")
def data(network, num=4, seed=1):
    keys = jax.random.split(jax.random.key(seed), 3)
    inputs, targets = jax.random.normal(keys[0], (num, 3)), jax.random.normal(keys[1], (num, 2))
    return network.draw_noise(keys[2], (6,)), inputs, targets


def arrays(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def test_loss_and_gradient_are_those_of_numpy():
    network, model = network_and_model()
    noise, inputs, targets = data(network)
    settings = {
        "prior": jnp.asarray(PRIOR),
        "likelihood": jnp.asarray(LIKELIHOOD),
        "num_batches": jnp.asarray(BATCHES),
    }
    loss = jax.value_and_grad(lambda n: n.loss(noise, inputs, targets, **settings))
    value, gradient = jax.jit(loss)(network)
    expected, expected_gradient = model.loss(*map(arrays, (noise,)), np.array(inputs), np.array(targets))
    np.testing.assert_allclose(value, expected, rtol=1e-12)
    for got, wanted in zip(arrays(gradient), expected_gradient, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)


def test_a_draw_has_the_moments_of_drawn_weights():
    network, _ = network_and_model()
    layer, inputs = network.layers[0], np.array([0.5, -1.0, 2.0])
    num, random = 40_000, np.random.default_rng(3)
    mean, deviation = np.asarray(layer.mean), np.asarray(layer.deviation)
    weights = mean + deviation * random.normal(size=(num, *mean.shape))
    drawn = np.append(inputs, 1.0) @ weights
    noise = random.normal(size=(num, mean.shape[1]))
    local = np.asarray(jax.jit(jax.vmap(lambda draw: layer(draw, jnp.asarray(inputs)[None])[0]))(noise))
    np.testing.assert_allclose(local.mean(axis=0), drawn.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(local.std(axis=0), drawn.std(axis=0), rtol=0.03)


@jax.jit
def gain_of(network, noise, inputs, targets, step):
    return network.information_gain(
        noise, inputs[0], targets[0], likelihood=jnp.asarray(LIKELIHOOD), step=step
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_half_of_the_information_gain_is_the_kl_divergence_of_a_small_step(seed):
    network, model = network_and_model(seed)
    noise, inputs, targets = data(network, num=1, seed=seed)
    errors = []
    for step in (1e-2, 1e-3, 1e-4):
        gain = float(gain_of(network, noise, inputs, targets, jnp.asarray(step)))
        after = model.stepped(arrays(noise), np.array(inputs), np.array(targets), step)
        errors.append(abs(0.5 * gain / after.kl(model) - 1.0))
    assert errors[0] < 0.1
    assert errors[1] < 0.2 * errors[0] and errors[2] < 0.2 * errors[1]  # of the order of the step


def test_a_network_starts_from_the_prior_deviations():
    draw = jax.jit(lambda key: BayesianNetwork.draw(key, (30, 40, 20), jnp.asarray(PRIOR)))
    for layer in draw(jax.random.key(0)).layers:
        np.testing.assert_allclose(layer.deviation, PRIOR, rtol=1e-9)
        assert abs(np.std(layer.mean) - 1.0) < 0.1
