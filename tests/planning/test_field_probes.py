"""Fields whose answer is known: where a planner that looks for values, for slopes or for the unknown goes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.fields.closed_form import Bumps, Step
from bojax.motions.base import place
from bojax.problems.objectives import GradientObjective
from tests.planning.samples import (
    OBJECTIVES,
    f64,
    field_belief,
    kcbts,
    monitoring,
    myopic,
    plan,
    quick_jit,
    random_planner,
    sbo,
)
from tests.tiers import by_tier

OPEN = {"walls": None, "target_area": None, "domain": (0.0, 0.0, 4.0, 4.0)}
PEAK = Bumps(f64([2.0]), f64([[3.0, 3.0]]), f64([0.6]))
STEEP = Step(f64([2.0, 2.0]), f64(0.0), f64(1.0), f64(0.3))
VALUE = eqx.tree_at(lambda o: o.kappa, OBJECTIVES["value"], f64(0.1))


@quick_jit
def episode(problem, planner, key):
    """How it ends; all samples taken, [steps, S, 2], and which; what each step was to pay, and paid."""
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

    steps = jnp.arange(2, 2 + problem.max_steps, dtype=jnp.int32)
    (world, belief), taken = jax.lax.scan(step, (world, belief), steps)
    std = problem.snapshot(world, belief)["belief"]["std"]
    return problem.score(world, belief) | {"std": jnp.mean(std)}, *taken


@pytest.mark.parametrize("make", [sbo, kcbts, myopic], ids=["sbo", "kcbts", "myopic"])
def test_with_the_peak_known_a_value_planner_drives_there(make):
    problem = monitoring(field=PEAK, start=(2.0, 2.0, np.pi / 4), noise=0.01, max_steps=20, **OPEN)
    belief = field_belief(problem, (2.1, 2.9, 0.0), 120)
    for seed in range(3):
        result = plan(make(objective=VALUE), jax.random.key(seed), problem, belief)
        end = place(result.path, belief.pose)[-1]
        assert jnp.linalg.norm(end[:2] - PEAK.centres[0]) < 0.5


@pytest.mark.slow
def test_in_an_episode_a_value_planner_comes_to_the_peak():
    problem = monitoring(field=PEAK, start=(0.5, 0.5, 0.0), noise=0.05, max_steps=14, **OPEN)
    nearest = []
    for seed in range(3):
        _, points, *_ = episode(problem, sbo(5, iterations=40), jax.random.key(seed))
        distance = np.linalg.norm(np.asarray(points) - np.asarray(PEAK.centres[0]), axis=-1)
        nearest.append(distance.mean(axis=1).min())
    assert max(nearest) < 1.0


@pytest.mark.slow
def test_an_explorer_covers_the_domain():
    problem = monitoring(field=STEEP, start=(0.5, 0.5, 0.0), max_steps=25, **OPEN)
    explorer, std = sbo(5, iterations=40, objective=OBJECTIVES["uncertainty"]), []
    for seed in range(2):
        scores, points, is_taken, *_ = episode(problem, explorer, jax.random.key(seed))
        cells = np.unique(np.asarray(points)[np.asarray(is_taken)].astype(int), axis=0)
        assert len(cells) >= 14  # of 16 square metres
        wanderer, *_ = episode(problem, random_planner(), jax.random.key(seed))
        std.append((scores["std"], wanderer["std"]))
    explored, wandered = np.mean(std, axis=0)
    assert explored < 0.9 * wandered


@pytest.mark.slow
def test_a_gradient_planner_samples_the_steep_band_more():
    problem = monitoring(field=STEEP, start=(1.0, 0.5, 1.5), max_steps=25, noise=0.05, **OPEN)
    seeker = sbo(5, iterations=40, objective=GradientObjective(f64(0.1)))
    explorer = sbo(5, iterations=40, objective=OBJECTIVES["uncertainty"])
    in_band, slope = np.zeros((2, 3)), np.zeros((2, 3))
    for which, planner in enumerate((seeker, explorer)):
        for seed in range(3):
            scores, points, is_taken, *_ = episode(problem, planner, jax.random.key(seed))
            x = np.asarray(points)[np.asarray(is_taken)][:, 0]
            in_band[which, seed] = np.mean(np.abs(x - 2.0) < 0.5)
            slope[which, seed] = scores["sampled_gradient"]
    # The band is a quarter of the domain.
    assert in_band.mean(axis=1)[0] > 0.5 > in_band.mean(axis=1)[1]
    assert slope.mean(axis=1)[0] > 1.2 * slope.mean(axis=1)[1]


@pytest.mark.parametrize("after_collision", by_tier(["stop", "turn"], normal=["turn"]))
def test_what_a_myopic_plan_expects_is_what_it_is_paid(after_collision):
    problem = monitoring("gradient", max_steps=15, after_collision=after_collision)
    *_, planned, paid = episode(problem, myopic(9), jax.random.key(0))
    np.testing.assert_allclose(planned, paid, atol=1e-9)
    assert np.all(np.isfinite(paid))


@pytest.mark.slow
def test_who_turns_round_gets_away_from_a_wall_and_who_stays_does_not():
    # All five splines lead ahead: a robot that faces a corner has nowhere to go.
    taken = {}
    for after_collision in ("stop", "turn"):
        problem = monitoring(
            start=(0.05, 0.05, 1.25 * np.pi), max_steps=5, after_collision=after_collision, walls=None
        )
        _, _, is_taken, *_ = episode(problem, myopic(5), jax.random.key(0))
        taken[after_collision] = int(np.sum(is_taken))
    assert taken["stop"] == 0 and taken["turn"] >= 12
