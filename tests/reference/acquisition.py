"""Acquisition functions, by the special functions of SciPy (Section 2.7.1)."""

import numpy as np
from scipy.special import erfcx, log_ndtr


class UpperConfidenceBound:
    """(2.37)"""

    def __init__(self, kappa):
        self.kappa = kappa

    def __call__(self, mean, std, best):
        return mean + self.kappa * std


class ProbabilityOfImprovement:
    """The logarithm of (2.36)."""

    def __init__(self, xi):
        self.xi = xi

    def __call__(self, mean, std, best):
        return log_ndtr(_standard_score(mean, std, best + self.xi))


class LogExpectedImprovement:
    """log(std (z Phi(z) + phi(z))), with Phi(z) = phi(z) sqrt(pi/2) erfcx(-z/sqrt 2) for z < 0."""

    def __init__(self, xi):
        self.xi = xi

    def __call__(self, mean, std, best):
        z = _standard_score(mean, std, best + self.xi)
        below, above = np.minimum(z, 0.0), np.maximum(z, 0.0)
        mills = np.sqrt(np.pi / 2.0) * erfcx(-below / np.sqrt(2.0))
        log_h_below = _log_density(below) + np.log1p(below * mills)
        log_h_above = np.log(np.exp(_log_density(above)) + above * np.exp(log_ndtr(above)))
        return np.where(z < 0.0, log_h_below, log_h_above) + np.log(_positive(std))


def _log_density(z):
    return -0.5 * z**2 - 0.5 * np.log(2.0 * np.pi)


def _positive(std):
    return np.maximum(std, np.finfo(float).eps)


def _standard_score(mean, std, threshold):
    return (mean - threshold) / _positive(std)
