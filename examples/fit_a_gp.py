"""Gaussian process regression: fit, add observations, learn hyper-parameters, predict and sample."""

import equinox as eqx
import jax
import jax.numpy as jnp

from bojax.models.evidence import relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Scaled

key_x, key_noise, key_starts, key_sample = jax.random.split(jax.random.key(0), 4)
x = jax.random.uniform(key_x, (30, 2), minval=-2.0, maxval=2.0)
y = jnp.sin(2.0 * x[:, 0]) + 0.1 * jax.random.normal(key_noise, (30,))


@eqx.filter_jit  # compiled as one program; without it, every operation is one
def fit(kernel, x, y):
    """A process on 30 observations, with room for 40."""
    gp = GaussianProcess.fit(kernel, 0.05, x[:20], y[:20], capacity=40)  # all at once
    gp = gp.update(x[20], y[20])  # one more
    return gp.extend(x[21:], y[21:])  # several more


@eqx.filter_jit
def describe(gp, key, queries):
    """Posterior of the noise-free function at points."""
    mean, variance = gp.predict(queries)
    return mean, jnp.sqrt(variance), gp.predict_gradient(queries), gp.sample(key, queries, 2)


gp = fit(Scaled(RBF([1.0, 1.0]), 1.0), x, y)

learned, optimum = eqx.filter_jit(relearn)(gp, key_starts)
evidence = eqx.filter_jit(GaussianProcess.log_marginal_likelihood)
print("log marginal likelihood:", evidence(gp), "->", evidence(learned))
print("lengthscales:", learned.kernel.kernel.lengthscale, "noise variance:", learned.noise_variance)

queries = jnp.asarray([[0.0, 0.0], [1.0, 1.0]])
mean, std, gradient, draws = describe(learned, key_sample, queries)
print("mean:", mean, "standard deviation:", std)
print("gradient of the mean:", gradient.ravel())
print("two draws:", draws.ravel())

# A noise variance for each observation: the right half was measured with a worse sensor.
own_noise = jnp.where(x[:, 0] < 0.0, 0.01, 0.25)
uneven = eqx.filter_jit(GaussianProcess.fit)(learned.kernel, 0.05, x, y, noise_variances=own_noise)
print("mean with uneven noise:", eqx.filter_jit(GaussianProcess.predict)(uneven, queries)[0])
