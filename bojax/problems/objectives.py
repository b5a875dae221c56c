"""Objectives of field monitoring: the reward of a sample, h in (3.1) and (4.10)."""

import abc
from typing import ClassVar, Literal, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from bojax.models.gaussian_process import GaussianProcess
from bojax.models.information import Places, entropy_taken, explained_variance
from bojax.numerics.linalg import matmul

Values: TypeAlias = Float[Array, "S"]
Gradients: TypeAlias = Float[Array, "S 2"]
Points: TypeAlias = Float[Array, "S 2"]


class FieldObjective(eqx.Module):
    """The reward of a sample under the belief before the path along which it is taken."""

    # Whether the gradient of the mean is needed; it is computed only then
    needs_gradient: ClassVar[bool] = False
    # Whether samples are rewarded for what they say about `Places` of the domain
    is_elsewhere: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        """Reward of each sample."""


class JointObjective(FieldObjective):
    """An objective that rewards each sample given those before it, which does not depend on their values."""

    @override
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        raise TypeError(
            f"{type(self).__name__}: the reward of a sample does not follow from its moments alone"
        )

    @abc.abstractmethod
    def of_samples(
        self, posterior: GaussianProcess, places: Places | None, points: Points, is_taken: Bool[Array, "S"]
    ) -> Values:
        """Reward of each sample in the order in which they are taken, under a belief before all of them.

        `places` are those of the domain if `is_elsewhere`, otherwise None.
        """


Uncertainty = Literal["std", "variance"]
"""Measure of uncertainty: Chapter 3 defines sigma as the variance, (2.37) as the standard deviation."""


def _spread(variance: Values, uncertainty: Uncertainty) -> Values:
    return jnp.sqrt(variance) if uncertainty == "std" else variance


class GradientObjective(FieldObjective):
    """Norm of the mean's gradient plus `kappa` standard deviations (3.2).

    BO-POMDP and the myopic planner maximise it.

    Settings: `bojax.problems.settings.Gradient`.
    """

    needs_gradient: ClassVar[bool] = True

    kappa: Float[Array, ""]
    uncertainty: Uncertainty = eqx.field(static=True, default="std")

    @override
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        assert gradient is not None
        norm = jnp.sqrt(jnp.sum(gradient * gradient, axis=-1))
        return norm + self.kappa * _spread(variance, self.uncertainty)


class ValueObjective(FieldObjective):
    """Mean plus `kappa` standard deviations (4.11).

    SBO and all planners of Section 4.7.1 maximise it.

    Settings: `bojax.problems.settings.Value`.
    """

    kappa: Float[Array, ""]
    uncertainty: Uncertainty = eqx.field(static=True, default="std")

    @override
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        return mean + self.kappa * _spread(variance, self.uncertainty)


class UncertaintyObjective(FieldObjective):
    """The standard deviation alone, which the myopic explorer of Section 3.5.1 maximises.

    Settings: `bojax.problems.settings.Uncertainty`.
    """

    uncertainty: Uncertainty = eqx.field(static=True, default="std")

    @override
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        return _spread(variance, self.uncertainty)


class InformationObjective(JointObjective):
    """Reduction of the mean variance over the domain by each sample, given those before it.

    The sum over a path is what the path reduces; samples close together are not counted twice. It is the
    criterion of A-optimal designs, and of active learning by Cohn (1996), Neural network exploration using
    optimal experiment design, as an integral over the domain without its walls.

    Settings: `bojax.problems.settings.Information`.
    """

    is_elsewhere: ClassVar[bool] = True

    @override
    def of_samples(
        self, posterior: GaussianProcess, places: Places | None, points: Points, is_taken: Bool[Array, "S"]
    ) -> Values:
        assert places is not None
        return matmul(explained_variance(posterior, places, points, is_taken), places.weights)


class EntropyObjective(JointObjective):
    """Entropy that each sample takes from the belief about the field, in nats, given those before it.

    It is the exact reward of information of a rho-POMDP (Araya-Lopez et al., NeurIPS 2010) for a Gaussian
    process: the sum over a path is the mutual information of field and samples, the criterion of D-optimal
    designs.

    Settings: `bojax.problems.settings.Entropy`.
    """

    @override
    def of_samples(
        self, posterior: GaussianProcess, places: Places | None, points: Points, is_taken: Bool[Array, "S"]
    ) -> Values:
        return entropy_taken(posterior, points, is_taken)
