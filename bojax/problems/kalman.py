"""Gaussian beliefs of linear problems: the Kalman filter (Kalman, 1960), exact where particles are not."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.numerics.linalg import full_precision


class LinearGaussian(eqx.Module):
    """A linear model: x' = A x + B a + noise, o = C x' + noise."""

    transition: Float[Array, "D D"]  # A
    control: Float[Array, "D K"]  # B
    sensor: Float[Array, "O D"]  # C
    process_covariance: Float[Array, "D D"]  # covariance of the noise of x'
    sensor_covariance: Float[Array, "O O"]  # covariance of the noise of o


class Gaussian(eqx.Module):
    """A Gaussian belief."""

    mean: Float[Array, "D"]
    covariance: Float[Array, "D D"]


@full_precision
def update(
    model: LinearGaussian, belief: Gaussian, action: Float[Array, "K"], observation: Float[Array, "O"]
) -> Gaussian:
    """The belief after an action and an observation."""
    mean = model.transition @ belief.mean + model.control @ action
    covariance = model.transition @ belief.covariance @ model.transition.T + model.process_covariance
    innovation = observation - model.sensor @ mean
    return condition(Gaussian(mean, covariance), model.sensor, model.sensor_covariance, innovation)


@full_precision
def condition(
    predicted: Gaussian,
    sensor: Float[Array, "O D"],
    sensor_covariance: Float[Array, "O O"],
    innovation: Float[Array, "O"],
) -> Gaussian:
    """The belief after an observation that differs from its mean by `innovation`."""
    innovation_covariance = sensor @ predicted.covariance @ sensor.T + sensor_covariance
    gain = jnp.linalg.solve(innovation_covariance, sensor @ predicted.covariance).T
    # Joseph's form: a sum of two positive semi-definite matrices, whatever the rounding of the gain.
    kept = jnp.eye(predicted.mean.shape[0], dtype=gain.dtype) - gain @ sensor
    updated = kept @ predicted.covariance @ kept.T + gain @ sensor_covariance @ gain.T
    return Gaussian(predicted.mean + gain @ innovation, updated)
