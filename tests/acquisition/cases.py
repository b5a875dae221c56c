"""The acquisition functions that all tests of this folder look at."""

import jax.numpy as jnp
import pytest

from bojax.acquisition.functions import LogExpectedImprovement, ProbabilityOfImprovement, UpperConfidenceBound

ACQUISITIONS = {
    "ucb": UpperConfidenceBound(jnp.asarray(2.0)),
    "pi": ProbabilityOfImprovement(jnp.asarray(0.01)),
    "log-ei": LogExpectedImprovement(jnp.asarray(0.01)),
}
each_acquisition = pytest.mark.parametrize("acquisition", ACQUISITIONS.values(), ids=ACQUISITIONS)
