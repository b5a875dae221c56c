"""Search for the best values of numeric settings: rounds of sweeps, proposed by Bayesian optimisation."""
