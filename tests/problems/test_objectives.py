"""What a sample of a field is worth: the formulas, and what they prefer."""

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.problems.objectives import GradientObjective, UncertaintyObjective, ValueObjective

RNG = np.random.default_rng(0)
MEAN, VARIANCE = jnp.asarray(RNG.normal(size=20)), jnp.asarray(RNG.uniform(0.0, 2.0, 20))
GRADIENT = jnp.asarray(RNG.normal(size=(20, 2)))
KAPPA = jnp.asarray(2.5)


@pytest.mark.parametrize(("uncertainty", "power"), [("std", 0.5), ("variance", 1.0)])
def test_the_objectives_are_their_formulas(uncertainty, power):
    spread = np.asarray(VARIANCE) ** power
    norm = np.hypot(*np.asarray(GRADIENT).T)
    cases = [
        (GradientObjective(KAPPA, uncertainty), norm + 2.5 * spread),  # (3.2)
        (ValueObjective(KAPPA, uncertainty), np.asarray(MEAN) + 2.5 * spread),  # (4.11)
        (UncertaintyObjective(uncertainty), spread),
    ]
    for objective, worth in cases:
        np.testing.assert_allclose(objective(MEAN, VARIANCE, GRADIENT), worth, rtol=1e-14)


def test_only_the_gradient_objective_asks_for_gradients():
    assert GradientObjective.needs_gradient
    for objective in (ValueObjective(KAPPA), UncertaintyObjective()):
        assert not objective.needs_gradient
        np.testing.assert_array_equal(objective(MEAN, VARIANCE, None), objective(MEAN, VARIANCE, GRADIENT))
