"""Objectives of field monitoring: the reward of a sample, h in (3.1) and (4.10)."""

import abc
from typing import ClassVar, Literal, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

Values: TypeAlias = Float[Array, "S"]
Gradients: TypeAlias = Float[Array, "S 2"]


class FieldObjective(eqx.Module):
    """The reward of a sample under the belief before the path along which it is taken.

    Attributes:
        needs_gradient: Whether the gradient of the mean is needed; it is computed only then.
    """

    needs_gradient: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, mean: Values, variance: Values, gradient: Gradients | None) -> Values:
        """Reward of each sample."""


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
