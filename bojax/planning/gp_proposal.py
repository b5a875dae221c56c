"""New actions of a belief search by Bayesian optimisation over the actions so far: CBTS on such beliefs.

Morere, Marchant and Ramos propose actions by a Gaussian process over immediate rewards (thesis, Algorithms 3
and 4; its Section 6.2 suggests returns). Returns of simulations are noisy means of unequally many samples.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.acquisition.functions import Acquisition
from bojax.acquisition.maximise import first_maximum
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.planning.proposals import Proposal, Target
from bojax.planning.tree import ROOT, Index, Totals, Tree, row
from bojax.problems.actions import ActionSpace

PRIOR_DEGREES = 2.0
"""Weight of the pooled variance in the variance of one action, in samples."""
LEAST_DEGREES = 3.0
"""Degrees of freedom from which a pooled variance is used."""


class _WithLevels(Kernel):
    """A kernel of points whose last coordinate is a level: times `correlation` between different levels."""

    kernel: Kernel
    correlation: Float[Array, ""]

    @override
    def __call__(self, x: Float[Array, "D"], y: Float[Array, "D"]) -> Float[Array, ""]:
        return self.kernel(x[:-1], y[:-1]) * jnp.where(x[-1] == y[-1], 1.0, self.correlation)


class GaussianProcessProposal(Proposal):
    """The action that maximises an acquisition under a Gaussian process of the node's actions.

    The observation of an action is the mean of its target over n visits, with noise variance s^2 / n, where
    s^2 = (2 s0^2 + M) / (n + 1), M is the sum of squared deviations, and s0^2 the variance within all
    actions of the node. While the node has fewer than three degrees of freedom, s0^2 is taken from the root,
    and while the root has too few, the variance between actions. Means are standardised to mean 0 and
    variance 1. The incumbent of an improvement is the highest posterior mean at an action, not the highest
    noisy mean.

    Settings: `bojax.planning.settings.GaussianProcessProposal`.
    """

    gains_from_passes: ClassVar[bool] = True
    """Makes the engine compile a search with this proposal at XLA's full optimisation level, also on a CPU.

    At the quick level, operations on its many small matrices take 2.3 times as long.
    """

    # What the process learns: the immediate "reward" (as in the thesis) or the "return"
    learns: Target = eqx.field(static=True)
    # Covariance of two actions' coordinates; an angle is a point on the unit circle, so that the squared
    # exponential kernel is exp(-2 sin^2(d / 2) / l^2) of a difference d
    kernel: Kernel
    level_correlation: Float[Array, ""]  # correlation of actions that differ only in the level
    acquisition: Acquisition  # score of an action
    # Variance added to each observation, relative to the variance of the means: returns drift while the
    # subtree grows
    noise_variance: Float[Array, ""]
    num_initial: int = eqx.field(static=True)  # number of first actions that are random
    # Number of random actions among which the proposal is chosen
    num_candidates: int = eqx.field(static=True)

    @property
    @override
    def target(self) -> Target:
        return self.learns

    @override
    def __call__(
        self, key: Key[Array, ""], space: ActionSpace, tree: Tree, node: Index, totals: Totals
    ) -> Float[Array, "P"]:
        candidates = jax.vmap(space.sample)(jax.random.split(key, self.num_candidates))
        process = self.process(space, tree, node, totals)
        mean, variance = process.predict(jax.vmap(lambda each: _point(space, each))(candidates))
        incumbent = jnp.max(jnp.where(totals[:, 0] > 0.0, process.predict(process.x)[0], -jnp.inf))
        best = first_maximum(self.acquisition(mean, jnp.sqrt(variance), incumbent))
        return candidates[jnp.where(process.count < self.num_initial, 0, best)]

    def process(self, space: ActionSpace, tree: Tree, node: Index, totals: Totals) -> GaussianProcess:
        """The process of a node, from points (coordinates and level) to standardised means."""
        parameters = tree.parameters_of(row(tree.children, node))
        visits, _, sums, deviations = totals.T
        exists = visits > 0.0
        num = jnp.maximum(visits, 1.0)
        means = sums / num
        num_actions = jnp.maximum(jnp.sum(exists, dtype=means.dtype), 1.0)
        centre = jnp.sum(jnp.where(exists, means, 0.0)) / num_actions
        spread = jnp.sum(jnp.where(exists, (means - centre) ** 2, 0.0)) / num_actions
        # Equal means carry no information about the surface: they are scaled to 0.
        scale = jnp.where(spread > 1e-12 * centre**2, spread, 1.0)

        pooled = _pooled(tree.totals_of(tree.children[ROOT]), scale)
        pooled = _pooled(totals, pooled)
        each = (PRIOR_DEGREES * pooled + deviations) / (PRIOR_DEGREES + num - 1.0)
        return GaussianProcess.fit(
            _WithLevels(self.kernel, self.level_correlation),
            self.noise_variance,
            jax.vmap(lambda each: _point(space, each))(parameters),
            (means - centre) / jnp.sqrt(scale),
            count=jnp.sum(exists, dtype=jnp.int32),  # the first actions of a node are those that exist
            noise_variances=each / (num * scale) + self.noise_variance,
        )


def _pooled(totals: Totals, otherwise: Float[Array, ""]) -> Float[Array, ""]:
    """The variance of the target within actions, if there are enough samples."""
    degrees = jnp.sum(jnp.maximum(totals[:, 0] - 1.0, 0.0))
    return jnp.where(degrees < LEAST_DEGREES, otherwise, jnp.sum(totals[:, 3]) / jnp.maximum(degrees, 1.0))


def _point(space: ActionSpace, parameters: Float[Array, "P"]) -> Float[Array, "C"]:
    coordinates = space.coordinates(parameters)
    return jnp.append(coordinates, space.level(parameters).astype(coordinates.dtype))
