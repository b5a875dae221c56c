"""Laws of growth with two coefficients, fitted to means by weighted least squares."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from typing_extensions import override

from bojax.report.statistics import Floats
from bojax.report.text import minus, number

Law: TypeAlias = Literal["linear", "quadratic", "exponential"]

LAWS: dict[Law, str] = {"linear": "a + b x", "quadratic": "a + b x²", "exponential": "a exp(b x)"}
"""The laws that are compared. Each has two coefficients, so none fits better only by having more."""

FLOOR = 0.05
"""Share of each mean that is added to its standard error in quadrature. No mean follows a law exactly, least
of all at small numbers, where standard errors are smallest and would otherwise decide the fit."""

_RATES = 2001
_BLOCK = 500


@dataclass(frozen=True)
class Fit:
    """One law fitted to means, or to each resample of them."""

    law: Law
    a: Floats  # first coefficient, `[]` or `[resamples]`
    b: Floats  # second coefficient
    misfit: Floats  # root mean square of the residuals, each divided by its error

    def __call__(self, x: Floats) -> Floats:
        """Evaluate a single fit at numbers `[n]`."""
        if self.law == "exponential":
            return self.a * np.exp(self.b * x)
        return self.a + self.b * (x if self.law == "linear" else x**2)

    @override
    def __str__(self) -> str:
        """The formula of a single fit."""
        a, b = minus(number(float(self.a))), number(abs(float(self.b)))
        if self.law == "exponential":
            return f"{a} exp({minus('-') if self.b < 0 else ''}{b} x)"
        return f"{a} {minus('-') if self.b < 0 else '+'} {b} x{'' if self.law == 'linear' else '²'}"


def errors_of(values: Floats) -> Floats:
    """Error of the mean of each column of `[runs, n]`: standard error and floor. NaNs are left out."""
    count = np.isfinite(values).sum(axis=0)
    variance = np.nanvar(values, axis=0, ddof=1) / count
    return np.sqrt(variance + (FLOOR * np.nanmean(values, axis=0)) ** 2)


def fit(law: Law, x: Floats, means: Floats, errors: Floats) -> Fit:
    """Fit a law to means `[..., n]` at numbers `[n]` by least squares, weighted by errors `[n]` to the -2."""
    flat = np.atleast_2d(np.asarray(means, dtype=np.float64))
    along = x**2 if law == "quadratic" else x
    a, b, squares = (_exponential if law == "exponential" else _line)(along, flat, errors**-2)
    shape = np.shape(means)[:-1]
    misfit = np.sqrt(np.maximum(squares, 0.0) / len(x))
    return Fit(law, a.reshape(shape), b.reshape(shape), misfit.reshape(shape))


def _line(x: Floats, means: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    total = weights.sum()
    centre, middle = weights @ x / total, means @ weights / total
    slope = (means - middle[:, None]) @ (weights * (x - centre)) / (weights @ (x - centre) ** 2)
    a = middle - slope * centre
    residuals = means - a[:, None] - slope[:, None] * x
    return a, slope, residuals**2 @ weights


def _exponential(x: Floats, means: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Search a fine grid of rates b; the best a for each b is known in closed form."""
    reach = 2.0 * np.log(means.max() / max(means.min(), 1e-9 * means.max())) + 1.0
    rates = np.linspace(-reach, reach, _RATES) / np.ptp(x)
    # The curves are 1 at the centre of x, so that no rate overflows.
    middle = (x.min() + x.max()) / 2
    curves = np.exp(rates[:, None] * (x - middle))
    norms = curves**2 @ weights
    found = []
    for start in range(0, len(means), _BLOCK):
        block = means[start : start + _BLOCK]
        along = (block * weights) @ curves.T
        explained = np.maximum(along, 0.0)
        explained *= explained  # in place, as is the next line: these arrays are what this function costs
        explained /= norms
        best = np.argmax(explained, axis=1)
        height = along[np.arange(len(block)), best] / norms[best]
        squares = (block - height[:, None] * curves[best]) ** 2 @ weights
        found.append((height * np.exp(-rates[best] * middle), rates[best], squares))
    a, b, squares = (np.concatenate(blocks) for blocks in zip(*found, strict=True))
    return a, b, squares
