"""Probabilistic models: Gaussian processes, Bayesian linear regression, their kernels and features."""
