"""Bayesian optimisation of an expensive function: step by step (ask and tell), and 100 runs in a batch."""

import jax
import jax.numpy as jnp

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.models.kernels import Matern52

search = BayesianOptimisation(
    kernel=Matern52(0.5),  # in units of the box, mapped to [-1, 1]^D, and of standardised values
    acquisition="log-ei",
    noise_variance=1e-4,
    low=[-5, 0],
    high=[10, 15],
    capacity=30,
)


def branin(key, x):
    """Branin's function, negated: its three maxima are -0.398."""
    del key  # no noise
    bowl = x[1] - 5.1 / (4.0 * jnp.pi**2) * x[0] ** 2 + 5.0 / jnp.pi * x[0] - 6.0
    return -(bowl**2 + 10.0 * (1.0 - 1.0 / (8.0 * jnp.pi)) * jnp.cos(x[0]) + 10.0)


# Ask and tell: the function may be evaluated outside of JAX, and return any kind of number.
state = search.init(jax.random.key(0))
for _ in range(30):
    x = search.ask(state)
    state = search.tell(state, x, float(branin(None, x)))
x, value = search.best(state)
print("best:", value, "at", x)

# The whole loop in one compiled program, and 100 runs in a batch.
keys = jax.random.split(jax.random.key(1), 100)
states, points, values = jax.jit(jax.vmap(lambda key: search.maximise(key, branin, 30)))(keys)
print("best of 100 runs, median:", jnp.median(jnp.max(values, axis=1)))
