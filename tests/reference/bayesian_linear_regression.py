"""Bayesian linear regression as Chapter 2 states it: matrices are inverted as they stand."""

import numpy as np


def posterior(features, targets, prior_precision, noise_precision):
    """Mean and covariance of the weights (2.14, 2.15)."""
    features, targets = np.asarray(features), np.asarray(targets)
    precision = prior_precision * np.eye(features.shape[1]) + noise_precision * features.T @ features
    covariance = np.linalg.inv(precision)
    return noise_precision * covariance @ features.T @ targets, covariance


def negative_log_evidence(features, targets, prior_precision, noise_precision):
    """The negative log marginal likelihood, term by term as (2.23, 2.24) print it."""
    features, targets = np.asarray(features), np.asarray(targets)
    (num_observations, num_features), (mean, covariance) = (
        features.shape,
        posterior(features, targets, prior_precision, noise_precision),
    )
    error = 0.5 * noise_precision * np.sum((targets - features @ mean) ** 2)
    error += 0.5 * prior_precision * mean @ mean
    return (
        error
        - 0.5 * np.linalg.slogdet(covariance)[1]
        + 0.5 * num_observations * np.log(2.0 * np.pi)
        - 0.5 * num_features * np.log(prior_precision)
        - 0.5 * num_observations * np.log(noise_precision)
    )


def evidence_gradient(features, targets, prior_precision, noise_precision):
    """Derivatives of the log evidence by the two precisions; the mean does not count, the error is least."""
    features, targets = np.asarray(features), np.asarray(targets)
    mean, covariance = posterior(features, targets, prior_precision, noise_precision)
    num_observations, num_features = features.shape
    by_prior = num_features / prior_precision - mean @ mean - np.trace(covariance)
    by_noise = num_observations / noise_precision - np.sum((targets - features @ mean) ** 2)
    by_noise -= np.trace(features @ covariance @ features.T)
    return 0.5 * by_prior, 0.5 * by_noise
