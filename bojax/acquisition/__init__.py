"""Bayesian optimisation: acquisition functions, their maximisation, and Thompson sampling."""
