"""A Bayesian neural network: a factorised Gaussian posterior of the weights, fitted by variational inference.

Blundell et al., "Weight uncertainty in neural networks" (ICML 2015), with the local reparametrisation of
Kingma, Salimans and Welling (NeurIPS 2015), as VIME uses them (Houthooft et al., NeurIPS 2016, Sections 2.3
and 2.4).
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from bojax.numerics.linalg import matmul

Noise: TypeAlias = tuple[Float[Array, "..."], ...]
"""Standard normal draws for each layer: `[O]` for its units, `[..., O]` for several draws of the outputs."""


class BayesianLayer(eqx.Module):
    """Linear functions of the inputs with independent Gaussian weights; the last row are biases."""

    mean: Float[Array, "R O"]  # means of the weights
    rho: Float[Array, "R O"]  # the standard deviations of the weights are log(1 + e^rho)

    @property
    def deviation(self) -> Float[Array, "R O"]:
        """Standard deviations of the weights."""
        return jax.nn.softplus(self.rho)

    def __call__(self, noise: Float[Array, "O"], inputs: Float[Array, "N I"]) -> Float[Array, "N O"]:
        """A draw of the outputs by local reparametrisation: their mean plus their deviation times the noise.

        All rows share the noise; they are not independent draws of the weights.
        """
        # A linear function of independent Gaussian weights is Gaussian: its moments are two products, and one
        # draw a unit replaces a draw of every weight.
        inputs = jnp.concatenate([inputs, jnp.ones_like(inputs[:, :1])], axis=1)
        variance = matmul(inputs**2, self.deviation**2)
        return matmul(inputs, self.mean) + jnp.sqrt(variance) * noise[None]


class BayesianNetwork(eqx.Module):
    """Layers of Gaussian weights with rectified units between them, and a Gaussian likelihood of outputs."""

    layers: tuple[BayesianLayer, ...]

    @classmethod
    def draw(
        cls, key: Key[Array, ""], sizes: Sequence[int], deviation: Float[Array, ""]
    ) -> "BayesianNetwork":
        """A network with means drawn from N(0, 1), and the given standard deviation of every weight.

        `sizes` are the numbers of inputs, of units of each hidden layer, and of outputs.
        """
        keys = jax.random.split(key, len(sizes) - 1)
        rho = jnp.log(jnp.expm1(deviation))

        def layer(key, num_inputs, num_outputs):
            shape = num_inputs + 1, num_outputs
            mean = jax.random.normal(key, shape, deviation.dtype)
            return BayesianLayer(mean, jnp.broadcast_to(rho, shape))

        return cls(tuple(layer(*args) for args in zip(keys, sizes[:-1], sizes[1:], strict=True)))

    def draw_noise(self, key: Key[Array, ""], shape: tuple[int, ...]) -> Noise:
        """Noise for draws of the outputs; `shape` goes before the units."""
        sizes = [layer.mean.shape[1] for layer in self.layers]
        draws = jax.random.normal(key, (*shape, sum(sizes)), self.layers[0].mean.dtype)
        return tuple(jnp.split(draws, np.cumsum(sizes)[:-1].tolist(), axis=-1))

    def predict(self, noise: Noise, inputs: Float[Array, "N I"]) -> Float[Array, "N O"]:
        """A draw of the outputs."""
        *hidden, last = zip(self.layers, noise, strict=True)
        for layer, draws in hidden:
            inputs = jax.nn.relu(layer(draws, inputs))
        return last[0](last[1], inputs)

    def negative_log_likelihood(
        self,
        noise: Noise,
        inputs: Float[Array, "N I"],
        targets: Float[Array, "N O"],
        deviation: Float[Array, ""],
    ) -> Float[Array, ""]:
        """-log p(targets), summed over rows and outputs; the mean of K draws of the outputs.

        The noise of the draws is `[K, O]` for each layer, and `deviation` that of the likelihood.
        """
        outputs = jax.vmap(lambda draws: self.predict(draws, inputs))(noise)
        errors = (targets[None] - outputs) / deviation
        constant = jnp.log(deviation) + 0.5 * math.log(2.0 * math.pi)
        return jnp.sum(0.5 * errors**2 + constant) / len(outputs)

    def kl_to_prior(self, prior: Float[Array, ""]) -> Float[Array, ""]:
        """KL divergence from the prior N(0, prior^2) of every weight."""
        total = jnp.zeros_like(prior)
        for layer in self.layers:
            deviation = layer.deviation
            squares = (layer.mean**2 + deviation**2) / prior**2
            total = total + jnp.sum(0.5 * (squares - 1.0) + jnp.log(prior) - jnp.log(deviation))
        return total

    def loss(
        self,
        noise: Noise,
        inputs: Float[Array, "N I"],
        targets: Float[Array, "N O"],
        *,
        prior: Float[Array, ""],
        likelihood: Float[Array, ""],
        num_batches: Float[Array, ""],
    ) -> Float[Array, ""]:
        """The negative evidence lower bound of a batch, KL(posterior, prior) / num_batches - log p(targets).

        `prior` and `likelihood` are standard deviations; see `negative_log_likelihood`.
        """
        error = self.negative_log_likelihood(noise, inputs, targets, likelihood)
        return self.kl_to_prior(prior) / num_batches + error

    def information_gain(
        self,
        noise: Noise,
        inputs: Float[Array, "I"],
        targets: Float[Array, "O"],
        *,
        likelihood: Float[Array, ""],
        step: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Twice the KL divergence between the posteriors after and before a Newton step on one observation.

        The step is `step` H^-1 g, with g the gradient of -log p(targets), and H the Hessian of the KL
        divergence, which is diagonal (Houthooft et al. 2016, Section 2.4). To second order, the divergence is
        step^2 g'H^-1 g / 2. The published code leaves out the factor 1/2, and so does this function. See
        `negative_log_likelihood` for the other arguments.
        """

        def error(network):
            return network.negative_log_likelihood(noise, inputs[None], targets[None], likelihood)

        # H is diagonal, so that g'H^-1 g is a sum over the weights: no matrix, and no second network for the
        # posterior after the step.
        gradient, inverse = jax.grad(error)(self), self.inverse_curvature()
        terms = jax.tree.map(lambda g, h: jnp.sum(g**2 * h), gradient, inverse)
        return step**2 * sum(jax.tree.leaves(terms), start=jnp.zeros_like(step))

    def inverse_curvature(self) -> "BayesianNetwork":
        """The diagonal of H^-1, in the places of `mean` and `rho`.

        The second derivative of the KL divergence is 1 / sigma^2 with respect to a mean, and 2 / sigma^2
        times (d sigma / d rho)^2 with respect to rho.
        """

        def of(layer: BayesianLayer) -> BayesianLayer:
            variance = layer.deviation**2
            return BayesianLayer(variance, variance / (2.0 * jax.nn.sigmoid(layer.rho) ** 2))

        return BayesianNetwork(tuple(of(layer) for layer in self.layers))
