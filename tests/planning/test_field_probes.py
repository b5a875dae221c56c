"""Fields whose answer is known: where a planner that looks for values, for slopes or for the unknown goes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.fields.closed_form import Bumps
from bojax.motions.base import place
from tests.planning.samples import (
    OBJECTIVES,
    f64,
    field_belief,
    kcbts,
    monitoring,
    myopic,
    plan,
    quick_jit,
    sbo,
)
from tests.tiers import by_tier

OPEN = {"walls": None, "target_area": None, "domain": (0.0, 0.0, 4.0, 4.0)}
PEAK = Bumps(f64([2.0]), f64([[3.0, 3.0]]), f64([0.6]))
VALUE = eqx.tree_at(lambda o: o.kappa, OBJECTIVES["value"], f64(0.1))


@quick_jit
def episode(problem, planner, key):
    """All samples taken, [steps, S, 2], and which; what each step was to pay, and paid."""
    world = problem.reset(jax.random.fold_in(key, 0))
    belief = problem.prior(jax.random.fold_in(key, 1), world, planner.motions.num_samples)

    def step(carry, index):
        world, belief = carry
        key_plan, key_world = jax.random.split(jax.random.fold_in(key, index))
        plan = planner.plan(key_plan, problem, belief)
        world, samples, events = problem.execute(key_world, world, plan.path)
        reward = problem.reward(getattr(planner, "objective", None), belief, plan.path, events)
        belief = problem.update(belief, plan.path, samples)
        return (world, belief), (samples.points, samples.is_taken, plan.reward, reward)

    return jax.lax.scan(step, (world, belief), jnp.arange(2, 2 + problem.max_steps, dtype=jnp.int32))[1]


@pytest.mark.parametrize(
    "make", by_tier([sbo, kcbts, myopic], normal=[myopic]), ids=["sbo", "kcbts", "myopic"]
)
def test_with_the_peak_known_a_value_planner_drives_there(make):
    problem = monitoring(field=PEAK, start=(2.0, 2.0, np.pi / 4), noise=0.01, max_steps=20, **OPEN)
    belief = field_belief(problem, (2.1, 2.9, 0.0), 120)
    for seed in range(3):
        result = plan(make(objective=VALUE), jax.random.key(seed), problem, belief)
        end = place(result.path, belief.pose)[-1]
        assert jnp.linalg.norm(end[:2] - PEAK.centres[0]) < 0.5


@pytest.mark.parametrize("after_collision", by_tier(["stop", "turn"], normal=["turn"]))
def test_what_a_myopic_plan_expects_is_what_it_is_paid(after_collision):
    problem = monitoring("gradient", max_steps=15, after_collision=after_collision)
    *_, planned, paid = episode(problem, myopic(9), jax.random.key(0))
    np.testing.assert_allclose(planned, paid, atol=1e-9)
    assert np.all(np.isfinite(paid))
