"""Acquisition functions, by the special functions of SciPy (Section 2.7.1)."""

import numpy as np
from scipy.special import erfcx, log_ndtr


def upper_confidence_bound(mean, std, best, kappa, uncertainty="std"):
    """(2.37), or (4.3) with its sigma read as the variance."""
    return mean + kappa * (std if uncertainty == "std" else std**2)


def probability_of_improvement(mean, std, best, xi):
    """The logarithm of (2.36)."""
    return log_ndtr((mean - best - xi) / _positive(std))


def log_expected_improvement(mean, std, best, xi):
    """log(std (z Phi(z) + phi(z))), with Phi(z) = phi(z) sqrt(pi/2) erfcx(-z/sqrt 2) for z < 0."""
    z = (mean - best - xi) / _positive(std)
    below, above = np.minimum(z, 0.0), np.maximum(z, 0.0)
    log_h_below = _log_density(below) + np.log1p(below * np.sqrt(np.pi / 2.0) * erfcx(-below / np.sqrt(2.0)))
    log_h_above = np.log(np.exp(_log_density(above)) + above * np.exp(log_ndtr(above)))
    return np.where(z < 0.0, log_h_below, log_h_above) + np.log(_positive(std))


def _log_density(z):
    return -0.5 * z**2 - 0.5 * np.log(2.0 * np.pi)


def _positive(std):
    return np.maximum(std, np.finfo(float).eps)
