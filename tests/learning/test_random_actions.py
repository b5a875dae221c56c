"""The baseline of random actions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning.settings import RandomActions
from tests.learning.probes import exploring


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_actions_are_uniform(scale):
    exploration = exploring(scale, is_learning=False)
    learner = build(RandomActions())

    def drawn(space):
        state = learner.init(jax.random.key(1), Discrete(3), space, capacity=10)
        act = jax.jit(jax.vmap(lambda key: learner.act(key, state, jnp.int32(0), exploration)[0]))
        return np.asarray(act(jax.random.split(jax.random.key(0), 2000)))

    box = drawn(Box(jnp.asarray([-1.0, 2.0]), jnp.asarray([1.0, 6.0])))
    for column, (low, width) in zip(box.T, [(-1.0, 2.0), (2.0, 4.0)], strict=True):
        assert stats.kstest(column, stats.uniform(low, width).cdf).pvalue > 1e-3
    assert stats.chisquare(np.bincount(drawn(Discrete(4)), minlength=4)).pvalue > 1e-3
