"""Search for the best settings: rounds of sweeps, proposed by Bayesian optimisation."""
