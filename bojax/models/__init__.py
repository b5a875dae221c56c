"""Probabilistic models: kernels and Gaussian processes."""
