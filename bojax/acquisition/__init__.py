"""Acquisition functions of Bayesian optimisation and their maximisation."""
