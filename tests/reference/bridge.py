"""The same settings and the same random numbers for both: from a JAX planner to its reference."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.acquisition import functions
from bojax.models import kernels, means
from bojax.numerics.choices import Choice
from bojax.numerics.linalg import noise_floor
from bojax.planning.cbts import ContinuousBeliefTreeSearch
from bojax.planning.discrete import DiscreteTreeSearch
from bojax.planning.gps_abt import PatternSearch
from bojax.problems import objectives
from bojax.problems.field_belief import FieldBelief
from bojax.problems.field_problem import FieldProblem
from tests.reference import acquisition, gps_abt, kcbts, mcts, monitoring, parking
from tests.reference import gaussian_process as gp

STATIONARY = {
    kernels.RBF: (gp.rbf, gp.rbf_slope),
    kernels.Matern12: (gp.matern12, gp.matern12_slope),
    kernels.Matern32: (gp.matern32, gp.matern32_slope),
    kernels.Matern52: (gp.matern52, gp.matern52_slope),
}
OBJECTIVES = {
    objectives.GradientObjective: "gradient",
    objectives.ValueObjective: "value",
    objectives.UncertaintyObjective: "uncertainty",
}


def reference_problem(problem, planner=None):
    """The reference of `problem`, as `planner` sees it."""
    if isinstance(problem, FieldProblem):
        objective = getattr(planner, "objective", None) or problem.objective
        return monitoring.Monitoring(
            objective=reference_objective(objective),
            domain=np.asarray(problem.domain),
            walls=np.zeros((0, 4)) if problem.walls is None else np.asarray(problem.walls),
            collision_reward=float(problem.collision_reward),
            exit_reward=float(problem.exit_reward),
            after_collision=problem.after_collision,
        )
    names = [field.name for field in dataclasses.fields(parking.Parking)]
    return parking.Parking(**{name: _plain(getattr(problem, name)) for name in names})


def reference_belief(belief):
    """The reference of a belief: what was observed, to be fitted anew, or a pose."""
    if not isinstance(belief, FieldBelief):
        return np.asarray(belief)
    posterior, count = belief.posterior, int(belief.posterior.count)
    kernel, mean = reference_kernel(posterior.kernel), reference_mean(posterior.mean)
    noise_variance = _noise_variance(posterior.kernel, posterior.noise_variance)

    def refit(x, y):
        return gp.GP(kernel, mean, noise_variance, x, y)

    x, y = (np.asarray(values)[:count] for values in (posterior.x, posterior.y))
    return monitoring.Belief(np.asarray(belief.pose), x, y, refit)


def drawn(planner, problem, key):
    """What `problem.simulate` draws in each iteration of `planner.search(key, ...)`, by action."""
    num_actions = 1 if getattr(planner, "heuristic", "rollout") == "zero" else planner.depth
    shape = (num_actions, planner.motions.num_samples)
    if not isinstance(problem, FieldProblem):
        return [[None] * num_actions] * planner.iterations
    if problem.imagined == "mean":
        return np.zeros((planner.iterations, *shape))
    _, key_simulate = jax.random.split(key)
    keys = jax.random.split(key_simulate, planner.iterations)
    normal = jax.vmap(lambda key: jax.random.normal(key, (shape[0] * shape[1],), problem.domain.dtype))(keys)
    return np.asarray(normal).reshape(planner.iterations, *shape)


def begin(planner, key):
    """What `planner.search(key, ...)` draws at its start: the two things that `planner.begin` returns."""
    key_begin, _ = jax.random.split(key)
    return eqx.filter_jit(planner.begin)(key_begin, planner.discount.dtype)


def reference_planner(planner, problem, memory, draws, problem_draws=None) -> mcts.TreeSearch:
    """The reference of `planner` on the random numbers that it began with.

    Args:
        planner: A tree search of bojax.
        problem: The reference problem.
        memory: Its empty memory, with the paths of the candidates.
        draws: The random numbers of all iterations.
        problem_draws: What the problem draws in them, see `drawn`; nothing if left out.
    """
    memory, draws = jax.tree.map(np.asarray, (memory, draws))
    settings = {
        "problem": problem,
        "iterations": planner.iterations,
        "depth": planner.depth,
        "discount": float(planner.discount),
        "exploration": float(planner.exploration),
        "rollout_paths": memory.paths[draws.rollout],
        "draws": [[None] * planner.depth] * planner.iterations if problem_draws is None else problem_draws,
    }
    match planner:
        case DiscreteTreeSearch():
            count = int(planner.motions.count)  # the further paths fill up the room of the largest set
            paths, order = memory.paths[:count], draws.untried[:, :count]
            return mcts.DiscreteTreeSearch(paths=paths, order=order, **settings)
        case ContinuousBeliefTreeSearch():
            return kcbts.ContinuousBeliefTreeSearch(
                kernel=reference_kernel(planner.kernel),
                acquisition=reference_acquisition(planner.acquisition),
                noise_variance=float(planner.noise_variance),
                max_actions=int(planner.max_actions.sum()),
                convergence=float(planner.convergence),
                scaling=planner.scaling,
                candidates=memory.candidates,
                paths=memory.paths,
                num_initial=planner.num_initial,
                initial=draws.untried,
                **settings,
            )
        case PatternSearch():
            if planner.heuristic == "zero":
                settings["rollout_paths"] = memory.paths[:0][None].repeat(planner.iterations, axis=0)
            path = eqx.filter_jit(planner.motions.path)
            return gps_abt.PatternSearch(
                motions_path=lambda params: np.asarray(path(params)),
                num_params=planner.motions.num_params,
                order=draws.untried,
                growth=float(planner.growth),
                min_visits=float(planner.min_visits),
                min_radius=float(planner.min_radius),
                initial_radius=float(planner.initial_radius),
                max_levels=planner.max_levels,
                **settings,
            )
    raise TypeError(f"no reference of {type(planner).__name__}")


def reference_kernel(kernel):
    """The same kernel, with its gradient."""
    match kernel:
        case kernels.Scaled():
            return gp.Scaled(reference_kernel(kernel.kernel), float(kernel.variance))
        case kernels.Sum() | kernels.Product():
            both = reference_kernel(kernel.first), reference_kernel(kernel.second)
            return (gp.Sum if isinstance(kernel, kernels.Sum) else gp.Product)(*both)
    return gp.Stationary(*STATIONARY[type(kernel)], np.asarray(kernel.lengthscale))


def reference_mean(mean) -> gp.LinearMean:
    match mean:
        case means.ZeroMean():
            return gp.LinearMean()
        case means.ConstantMean():
            return gp.LinearMean(bias=float(mean.value))
        case means.LinearMean():
            return gp.LinearMean(np.asarray(mean.weights), float(mean.bias))
    raise TypeError(f"no reference of {type(mean).__name__}")


def reference_objective(objective) -> monitoring.Objective:
    kappa = float(getattr(objective, "kappa", 0.0))
    return monitoring.Objective(OBJECTIVES[type(objective)], kappa, objective.uncertainty)


def reference_acquisition(function):
    match function:
        case functions.UpperConfidenceBound():
            settings = {"kappa": float(function.kappa), "uncertainty": function.uncertainty}
            return partial(acquisition.upper_confidence_bound, **settings)
        case functions.ProbabilityOfImprovement():
            return partial(acquisition.probability_of_improvement, xi=float(function.xi))
        case functions.LogExpectedImprovement():
            return partial(acquisition.log_expected_improvement, xi=float(function.xi))
    raise TypeError(f"no reference of {type(function).__name__}")


def _noise_variance(kernel, noise_variance) -> float:
    """The noise as it enters a factor: at least the floor, of a stationary prior."""
    origin = jnp.zeros((2,), noise_variance.dtype)
    return max(float(noise_variance), noise_floor(origin.dtype) * float(kernel(origin, origin)))


def _plain(value):
    if isinstance(value, Choice):
        return value.names[int(value.index)]
    return float(value) if isinstance(value, jax.Array) else value
