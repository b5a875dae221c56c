"""Small planners and problems with every setting spelled out, and a search compiled once per structure."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.acquisition.functions import (
    LogExpectedImprovement,
    ProbabilityOfImprovement,
    UpperConfidenceBound,
)
from bojax.fields.closed_form import Bumps
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Scaled
from bojax.models.means import ZeroMean
from bojax.motions.splines import SplineSet
from bojax.planning.cbts import ContinuousBeliefTreeSearch
from bojax.planning.discrete import DiscreteTreeSearch
from bojax.planning.gps_abt import PatternSearch
from bojax.planning.myopic import MyopicPlanner
from bojax.problems.field_problem import FieldProblem
from bojax.problems.objectives import GradientObjective, UncertaintyObjective, ValueObjective
from bojax.problems.parking import Parking
from tests.arrays import f64
from tests.motions import families
from tests.reference import parking as reference

ACQUISITIONS = {
    "ucb": UpperConfidenceBound(f64(3.0)),
    "ucb, variance": UpperConfidenceBound(f64(3.0), "variance"),
    "log-ei": LogExpectedImprovement(f64(0.01)),
    "pi": ProbabilityOfImprovement(f64(0.01)),
}


def kernel_trajectories(num_segments=3):
    return dataclasses.replace(families.kernel(num_segments=num_segments), num_samples=6)


def parking(distance_tolerance=0.25, heading_noise=0.02, position_noise=0.02, max_steps=15, **settings):
    """Robot parking with the given settings; the others are the thesis's."""
    values = vars(reference.Parking(distance_tolerance=distance_tolerance, **settings))
    return Parking(
        **{name: f64(value) if isinstance(value, float) else value for name, value in values.items()},
        position_noise=f64(position_noise),
        heading_noise=f64(heading_noise),
        max_steps=max_steps,
    )


OBJECTIVES = {
    "gradient": GradientObjective(f64(2.0)),
    "value": ValueObjective(f64(3.0)),
    "value, variance": ValueObjective(f64(3.0), "variance"),
    "uncertainty": UncertaintyObjective(),
}

FIELD = Bumps(f64([1.0, -0.7]), f64([[2.2, 0.8], [0.6, 1.8]]), f64([0.5, 0.7]))


def monitoring(
    objective="value",
    kernel=None,
    mean=None,
    walls=((1.2, 0.0, 1.4, 1.0), (1.2, 1.5, 1.4, 2.4)),
    start=None,
    target_area=(1.4, 0.0, 3.0, 2.4),
    noise_variance=0.01,
    noise=0.1,
    max_steps=4,
    field=FIELD,
    domain=(0.0, 0.0, 3.0, 2.4),
    **choices,
):
    """Two rooms of 1.2 and 1.6 m with a gap of half a metre between them."""
    settings = {
        "resolution": 12,
        "imagined": "sample",
        "after_collision": "turn",
        "weighting": "value",
        "relearn_every": 0,
    }
    return FieldProblem(
        field=field,
        domain=f64(domain),
        walls=None if walls is None else f64(walls),
        start=None if start is None else f64(start),
        target_area=None if target_area is None else f64(target_area),
        objective=OBJECTIVES[objective],
        kernel=kernel or Scaled(RBF(f64(0.6)), f64(0.8)),
        mean=mean or ZeroMean(),
        noise_variance=f64(noise_variance),
        noise=f64(noise),
        collision_reward=f64(-5.0),
        exit_reward=f64(-4.0),
        relearn_spread=f64(0.5),
        max_steps=max_steps,
        **(settings | choices),
    )


def field_belief(problem, pose, num_observations, num_samples=6, seed=0):
    """At a pose, after observations all over the domain."""
    rng = np.random.default_rng(seed)
    capacity = problem.max_steps * num_samples
    x = f64(rng.uniform(problem.domain[:2], problem.domain[2:], (capacity, 2)))
    noise, count = f64(rng.normal(size=capacity)), jnp.asarray(num_observations, jnp.int32)
    keys = jax.random.key(seed), jax.random.key(seed)
    return _belief_at(keys, problem, f64(pose), x, noise, count, num_samples)


@eqx.filter_jit
def _belief_at(keys, problem, pose, x, noise, count, num_samples):
    y = problem.field.values(x) + problem.noise * noise
    world = dataclasses.replace(problem, start=pose).reset(keys[0])
    prior = problem.prior(keys[1], world, num_samples)
    posterior = GaussianProcess.fit(
        problem.kernel, problem.noise_variance, x, y, mean=problem.mean, count=count
    )
    return dataclasses.replace(prior, pose=pose, posterior=posterior)


FIELD_POSES = {
    "in a room": (0.5, 1.2, 0.5),
    "before a wall": (1.0, 0.5, 0.2),
    "in the gap": (1.1, 1.25, 0.1),
    "at the border": (2.8, 0.3, -0.5),
    "in a corner": (0.05, 0.05, 3.9),
}


def cubic_curves():
    return dataclasses.replace(families.cubic(), num_samples=6)


def kcbts(
    acquisition="ucb",
    depth=3,
    iterations=60,
    scaling="standardise",
    discount=1.0,
    exploration=10.0,
    convergence=0.0,
    max_actions=6,
    num_initial=2,
    refine_steps=0,
    motions=None,
    objective=None,
    measures_shortfall=False,
):
    return ContinuousBeliefTreeSearch(
        motions=motions or kernel_trajectories(),
        kernel=RBF(f64(0.7)),
        acquisition=ACQUISITIONS[acquisition],
        noise_variance=f64(0.01),
        exploration=f64(exploration),
        convergence=f64(convergence),
        discount=f64(discount),
        iterations=iterations,
        depth=depth,
        max_actions=max_actions,
        num_candidates=32,
        num_initial=num_initial,
        refine_steps=refine_steps,
        scaling=scaling,
        objective=objective,
        measures_shortfall=measures_shortfall,
    )


def sbo(actions=5, iterations=60, depth=3, discount=1.0, exploration=10.0, objective=None):
    return DiscreteTreeSearch(
        motions=SplineSet(f64(1.0), actions, 6),
        exploration=f64(exploration),
        discount=f64(discount),
        iterations=iterations,
        depth=depth,
        objective=objective,
    )


def gps_abt(iterations=60, depth=3, discount=1.0, exploration=10.0, heuristic="rollout", objective=None):
    return PatternSearch(
        motions=kernel_trajectories(num_segments=2),
        exploration=f64(exploration),
        growth=f64(2.0),
        min_visits=f64(1.0),
        min_radius=f64(0.1),
        initial_radius=f64(1.0 / 3.0),
        discount=f64(discount),
        iterations=iterations,
        depth=depth,
        max_levels=4,
        num_rollout_paths=16,
        heuristic=heuristic,
        objective=objective,
    )


def myopic(actions=5, objective=None):
    return MyopicPlanner(SplineSet(f64(1.0), actions, 6), objective)


POSES = {
    "far": (2.5, -1.5, 2.0),
    "before the lot": (-0.7, 0.05, 0.0),
    "at the border": (3.8, 3.0, 1.2),
    "in the corner": (3.9, -3.9, 5.5),
    "beside the lot": (0.3, 1.2, 4.6),
}


# These programs run for milliseconds: what costs time is to compile them. Not so on a GPU, where XLA of JAX
# 0.11.2 makes wrong programs of them without optimisation: plans whose path is not that of their action.
quick_jit = eqx.filter_jit


@quick_jit
def search(planner, key, problem, belief):
    """The tree, what the planner remembers, the child it recommends, and what it drew before."""
    key_begin, _ = jax.random.split(jax.random.clone(key))
    begun = planner.begin(key_begin, planner.discount.dtype)
    tree, memory = planner.search(key, problem, belief)
    return tree, memory, planner.recommend(tree, memory), begun


@quick_jit
def path_of(motions, params):
    """The path of one parameter vector."""
    return motions.path(params)


@quick_jit
def plan(planner, key, problem, belief):
    """One plan."""
    return planner.plan(key, problem, belief)


@quick_jit
def plans(planners, keys, problem, beliefs):
    """A batch of plans; every array of `planners` has a leading axis of lanes too."""
    return eqx.filter_vmap(lambda planner, key, belief: planner.plan(key, problem, belief))(
        planners, keys, beliefs
    )
