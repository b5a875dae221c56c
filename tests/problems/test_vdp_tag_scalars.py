"""The model that peers in Python plan with is that of bojax."""

import importlib
from pathlib import Path

import jax
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.problems.pomdp.settings import VdpTag


@pytest.fixture
def scalars(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("vdp_tag_scalars")


def test_peers_plan_on_the_same_problem(scalars):
    problem = build(VdpTag())
    move, drift = jax.jit(lambda *x: problem.move(*x)), jax.jit(lambda x: problem.drift(x))
    density = jax.jit(lambda *x: problem.log_likelihood(*x))
    rng = np.random.default_rng(0)
    stopped = 0
    for _ in range(60):
        agent, target = rng.uniform(-0.8, 0.8, 2), rng.uniform(-3.0, 3.0, 2)
        angle, look = rng.uniform(0.0, 2.0 * np.pi), bool(rng.integers(2))
        moved = scalars.move(*agent, angle)
        np.testing.assert_allclose(moved, move(agent, angle), atol=1e-9)
        np.testing.assert_allclose(scalars.drift(*target), drift(target), atol=1e-9)
        stopped += np.hypot(*(moved - agent)) < 0.49
        seen = scalars.readings(tuple(agent), tuple(target), look)
        state = np.array([*agent, *target])
        expected = density(np.array(seen), state, np.array([angle, float(look)]), state)
        assert scalars.log_density(seen, tuple(agent), tuple(target), look) == pytest.approx(float(expected))
    assert 0 < stopped < 60
    assert [scalars.reward(*case) for case in ((True, True), (False, False))] == [95.0, -1.0]
