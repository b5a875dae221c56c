"""The same settings and the same random numbers for both: from a JAX planner to its reference."""

import dataclasses

import equinox as eqx
import jax
import numpy as np

from bojax.acquisition import functions
from bojax.models import kernels
from bojax.planning.cbts import ContinuousBeliefTreeSearch
from bojax.planning.discrete import DiscreteTreeSearch
from bojax.planning.gps_abt import PatternSearch
from bojax.problems.parking import Parking
from tests.reference import acquisition, gps_abt, kcbts, mcts, node_gp, parking

PROFILES = {
    kernels.RBF: node_gp.rbf,
    kernels.Matern12: node_gp.matern12,
    kernels.Matern32: node_gp.matern32,
    kernels.Matern52: node_gp.matern52,
}


def reference_problem(problem: Parking) -> parking.Parking:
    names = [field.name for field in dataclasses.fields(parking.Parking)]
    return parking.Parking(**{name: _plain(getattr(problem, name)) for name in names})


def begin(planner, key):
    """What `planner.search(key, ...)` draws at its start: the two things that `planner.begin` returns."""
    key_begin, _ = jax.random.split(key)
    return eqx.filter_jit(planner.begin)(key_begin, planner.discount.dtype)


def reference_planner(planner, problem, memory, draws) -> mcts.TreeSearch:
    """The reference of `planner` on the random numbers that it began with.

    Args:
        planner: A tree search of bojax.
        problem: The reference problem.
        memory: Its empty memory, with the paths of the candidates.
        draws: The random numbers of all iterations.
    """
    memory, draws = jax.tree.map(np.asarray, (memory, draws))
    settings = {
        "problem": problem,
        "iterations": planner.iterations,
        "depth": planner.depth,
        "discount": float(planner.discount),
        "exploration": float(planner.exploration),
        "rollout_paths": memory.paths[draws["rollout"]],
    }
    match planner:
        case DiscreteTreeSearch():
            return mcts.DiscreteTreeSearch(paths=memory.paths, order=draws["order"], **settings)
        case ContinuousBeliefTreeSearch():
            return kcbts.ContinuousBeliefTreeSearch(
                kernel=reference_kernel(planner.kernel),
                acquisition=reference_acquisition(planner.acquisition),
                noise_variance=float(planner.noise_variance),
                max_actions=planner.max_actions,
                convergence=float(planner.convergence),
                scaling=planner.scaling,
                candidates=memory.candidates,
                paths=memory.paths,
                num_initial=planner.num_initial,
                initial=draws["initial"],
                **settings,
            )
        case PatternSearch():
            if planner.heuristic == "zero":
                settings["rollout_paths"] = memory.paths[:0][None].repeat(planner.iterations, axis=0)
            path = eqx.filter_jit(planner.motions.path)
            return gps_abt.PatternSearch(
                motions_path=lambda params: np.asarray(path(params)),
                num_params=planner.motions.num_params,
                order=draws["order"],
                growth=float(planner.growth),
                min_visits=float(planner.min_visits),
                min_radius=float(planner.min_radius),
                initial_radius=float(planner.initial_radius),
                max_levels=planner.max_levels,
                **settings,
            )
    raise TypeError(f"no reference of {type(planner).__name__}")


def reference_kernel(kernel) -> node_gp.Kernel:
    return node_gp.Kernel(PROFILES[type(kernel)], np.asarray(kernel.lengthscale))


def reference_acquisition(function):
    match function:
        case functions.UpperConfidenceBound():
            return acquisition.UpperConfidenceBound(float(function.kappa))
        case functions.ProbabilityOfImprovement():
            return acquisition.ProbabilityOfImprovement(float(function.xi))
        case functions.LogExpectedImprovement():
            return acquisition.LogExpectedImprovement(float(function.xi))
    raise TypeError(f"no reference of {type(function).__name__}")


def _plain(value):
    return float(value) if isinstance(value, jax.Array) else value
