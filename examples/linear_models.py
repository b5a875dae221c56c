"""Bayesian linear regression on random Fourier features: a sparse Gaussian process."""

import equinox as eqx
import jax
import jax.numpy as jnp

from bojax.models.bayesian_linear_regression import BayesianLinearRegression, maximise_evidence
from bojax.models.features import Polynomial, RandomFourier
from bojax.models.kernels import RBF
from bojax.models.linear_regression import LinearRegression

key_x, key_noise, key_features = jax.random.split(jax.random.key(0), 3)
x = jax.random.uniform(key_x, (500, 1), minval=-3.0, maxval=3.0)
y = jnp.sin(2.0 * x[:, 0]) + 0.1 * jax.random.normal(key_noise, (500,))
queries = jnp.asarray([[0.0], [0.8]])


@eqx.filter_jit  # compiled as one program; without it, every operation is one
def polynomials(x, y, queries):
    """Least squares (2.8) and its maximum a posteriori estimate (2.14), on the powers of x."""
    cubic = Polynomial(degree=3, num_dims=1)
    design, at_queries = cubic.design(x), cubic.design(queries)
    ridge = LinearRegression.fit_map(design, y, prior_precision=1, noise_precision=4)
    return LinearRegression.fit(design, y).predict(at_queries), ridge.predict(at_queries)


@eqx.filter_jit
def bayesian(key, x, y, queries):
    """The posterior of the weights (2.13), on features whose inner product approximates a kernel."""
    fourier = RandomFourier.draw(key, RBF(1.0), num_features=64, num_dims=1)
    design, at_queries = fourier.design(x), fourier.design(queries)
    alpha, beta = maximise_evidence(design, y)  # both precisions, by type-II maximum likelihood
    batch = BayesianLinearRegression.fit(design, y, alpha, beta)  # (2.14, 2.15)
    prior = BayesianLinearRegression.prior(64, alpha, beta, block=10)
    sequential, _ = jax.lax.scan(learn, prior, (design.reshape(50, 10, 64), y.reshape(50, 10)))
    return 1.0 / jnp.sqrt(beta), batch.predict(at_queries), sequential.predict(at_queries)


def learn(model, block):
    """Ten observations one by one (5.22), with one pass over the covariance at the end."""
    for step, (phi, target) in enumerate(zip(*block, strict=True)):
        model = model.update(phi, target, step_in_block=step)
    return model.flush(), None


least_squares, most_probable = polynomials(x, y, queries)
print("least squares:", least_squares)
print("most probable:", most_probable)

noise, batch, sequential = bayesian(key_features, x, y, queries)
print("noise:", noise)
print("batch:", *batch)
print("one by one:", *sequential)
