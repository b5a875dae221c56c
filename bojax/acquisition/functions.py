"""Acquisition functions for maximisation (Section 2.7.1): the value of evaluating a point."""

import abc
from typing import Literal, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.models.checks import as_numbers

Values: TypeAlias = Float[Array, "*N"]
"""A number for each of several points."""


class Acquisition(eqx.Module):
    """A score of a point, given the posterior mean and standard deviation there."""

    @abc.abstractmethod
    def __call__(self, mean: Values, std: Values, best: Float[Array, ""]) -> Values:
        """Score of each point; `best` is the highest observed value."""


class UpperConfidenceBound(Acquisition):
    """Mean plus `kappa` times the uncertainty (2.37).

    (2.37) has the standard deviation, the default; the text of (4.3) calls sigma the variance.

    Settings: `bojax.acquisition.settings.UpperConfidenceBound`.
    """

    kappa: Float[Array, ""] = eqx.field(converter=as_numbers("kappa"))
    uncertainty: Literal["std", "variance"] = eqx.field(static=True, default="std")

    @override
    def __call__(self, mean: Values, std: Values, best: Float[Array, ""]) -> Values:
        return mean + self.kappa * (std if self.uncertainty == "std" else jnp.square(std))


class ProbabilityOfImprovement(Acquisition):
    """Logarithm of the probability that the value exceeds `best + xi`, xi >= 0 (2.36).

    Equation 2.35 is printed for minimisation.

    Settings: `bojax.acquisition.settings.ProbabilityOfImprovement`.
    """

    xi: Float[Array, ""] = eqx.field(converter=as_numbers("xi"))

    @override
    def __call__(self, mean: Values, std: Values, best: Float[Array, ""]) -> Values:
        # The logarithm preserves the order of the points, and does not underflow to ties far below the best.
        return norm.logcdf(_standard_score(mean, std, best + self.xi))


class ExpectedImprovement(Acquisition):
    """Expected improvement over `best + xi` (Jones, Schonlau and Welch, 1998, equation 15).

    Not in the thesis. The score is std (phi(z) + z Phi(z)), with the standard score z. At a z below about -37
    in float64 (-13 in float32) it underflows to 0, and such points are tied; `LogExpectedImprovement` ranks
    them.

    Settings: `bojax.acquisition.settings.ExpectedImprovement`.
    """

    xi: Float[Array, ""] = eqx.field(converter=as_numbers("xi"))

    @override
    def __call__(self, mean: Values, std: Values, best: Float[Array, ""]) -> Values:
        return jnp.exp(_log_h(_standard_score(mean, std, best + self.xi))) * _positive(std)


class LogExpectedImprovement(Acquisition):
    """Logarithm of the expected improvement over `best + xi` (Ament et al., NeurIPS 2023, Section 4.1).

    Not in the thesis. The score is finite for standard scores above -1e150 in float64 (-1e18 in float32).

    Settings: `bojax.acquisition.settings.LogExpectedImprovement`.
    """

    xi: Float[Array, ""] = eqx.field(converter=as_numbers("xi"))

    @override
    def __call__(self, mean: Values, std: Values, best: Float[Array, ""]) -> Values:
        return _log_h(_standard_score(mean, std, best + self.xi)) + jnp.log(_positive(std))


def _positive(std: Values) -> Values:
    return jnp.maximum(std, jnp.finfo(std.dtype).eps)


def _standard_score(mean: Values, std: Values, threshold: Float[Array, ""]) -> Values:
    return (mean - threshold) / _positive(std)


def _log_h(z: Values) -> Values:
    """log(phi(z) + z Phi(z)) without cancellation, in three ranges of z."""
    # Above -1 the formula is evaluated directly. Below, it is written with the Mills ratio, where 1 + z
    # Phi/phi loses at most three digits. From -20 down (-10 in float32), where `norm.logcdf` becomes too
    # inaccurate for this, it is the asymptotic series phi(z)/z^2 (1 - 3/z^2 + 15/z^4 - 105/z^6 + 945/z^8 -
    # ...).
    border = -20.0 if jnp.finfo(z.dtype).bits == 64 else -10.0
    is_high, is_low = z > -1.0, z <= border
    # Each formula receives numbers of its own range only, so that no value and no gradient overflows.
    high = jnp.where(is_high, z, 0.0)
    middle = jnp.where(is_high | is_low, -1.0, z)
    low = jnp.where(is_low, z, border)
    ratio = jnp.exp(norm.logcdf(middle) - norm.logpdf(middle))
    u = 1.0 / (low * low)
    series = jnp.log1p(u * (-3.0 + u * (15.0 + u * (-105.0 + u * (945.0 + u * (-10395.0 + u * 135135.0))))))
    return jnp.where(
        is_high,
        jnp.log(jnp.exp(norm.logpdf(high)) + high * norm.cdf(high)),
        jnp.where(
            is_low,
            norm.logpdf(low) - 2.0 * jnp.log(-low) + series,
            norm.logpdf(middle) + jnp.log1p(middle * ratio),
        ),
    )
