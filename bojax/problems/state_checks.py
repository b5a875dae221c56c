"""Checks of a user's state problem before anything runs, on a few random walks of its model.

A mistake in a likelihood gives no error in a run, only a wrong belief: these checks find the usual ones.
"""

import dataclasses
import inspect
from typing import NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from bojax.models.checks import is_known
from bojax.numerics.trial import Misfit, computed, described, is_users, require, trial, trial_of
from bojax.problems import particles
from bojax.problems.actions import ActionSpace, Box
from bojax.problems.state_space import OVERRIDABLE, StateProblem

_NUM_WALKS, _NUM_STEPS, _NUM_OBSERVATIONS, _NUM_PARTICLES = 8, 3, 256, 1000
_MOST_DISTINCT = 32
"""A set of observations is taken for finite if `_NUM_OBSERVATIONS` draws have at most so many values."""
_MOST_RATIO = 1000.0
"""Largest mean ratio of densities, see `_check_fit`."""
_NUM_COMPARED = 16
"""Number of observations of a transition in such a ratio."""
_MOST_DIFFERENCE = 0.2
"""Largest difference of a probability and the share of draws; six standard deviations of the share."""


def check_model(problem: StateProblem) -> None:
    """Call the methods of a user's problem on random walks, or raise ValueError with one line.

    Refused are: wrong shapes and precisions; a discount outside (0, 1]; random actions outside the space;
    NaN; methods that are not pure; an observation that no particle explains; a likelihood that does not fit
    the observations, see `_check_fit`; and a likelihood that is not the logarithm of one. That is so if the
    probabilities of a finite set of observations do not sum to 1 or are not those with which `observe` draws
    them, or if the logarithm is the same, or never negative, even far from all observations. Whether a
    density integrates to 1 is not checked. Also refused is a `has_discrete_observations` that contradicts the
    observations of the walks.

    Classes of bojax, and problems that JAX is tracing, pass.
    """
    if not is_users(problem) or not is_known(problem):
        return
    try:
        with trial_of(type(problem).__name__):
            _check_fields(problem)
        trial(problem, _check_shapes, jax.random.key(0))
        with trial_of(type(problem).__name__):
            _check_numbers(problem)
    except ValueError as error:
        raise ValueError(f"problem: {error}") from error


def _check_fields(problem: StateProblem) -> None:
    """Refuse fields that must be static, or must not, methods with other parameters, and bounds of angles."""
    static = {field.name for field in dataclasses.fields(problem) if field.metadata.get("static")}
    if "max_steps" not in static or not isinstance(problem.max_steps, int):
        _refuse("max_steps: allowed: a field max_steps: int = eqx.field(static=True, default=30)")
    if not isinstance(problem.discount, Array):
        _refuse(f"discount is {described(problem.discount)}; allowed: a field of an array, not a static one")
    for name in OVERRIDABLE[1:]:
        expected = inspect.signature(getattr(StateProblem, name)).parameters
        try:
            inspect.signature(getattr(type(problem), name)).bind(*expected)
        except TypeError as error:
            raise Misfit(f"{name}: {error}; allowed: {name}({', '.join(expected)})") from error
    for box in jax.tree.leaves(problem.actions, is_leaf=lambda part: isinstance(part, Box)):
        if isinstance(box, Box) and box.is_angle and not _is_turn(np.asarray(box.high - box.low)):
            _refuse("actions: is_angle, but the bounds of Box are not one turn apart; allowed: 2 pi or 360")


def _check_shapes(problem: StateProblem, key: Key[Array, ""]) -> None:
    keys = jax.random.split(key, 6)
    require("discount", problem.discount, jnp.zeros((), problem.discount.dtype))
    state = problem.initial(keys[0])
    _require_vector("initial", state, problem.discount)
    if not isinstance(problem.actions, ActionSpace):
        name = type(problem.actions).__name__
        _refuse(f"actions is {name}; allowed: a property with a space of bojax.problems.actions, such as Box")
    action = problem.actions.decode(problem.actions.sample(keys[1]))
    _require_vector("an action of the space", action, problem.discount)
    stepped = problem.step(keys[2], state, action)
    if not isinstance(stepped, tuple) or len(stepped) != 3:
        _refuse("step: allowed: three values, the next state, the reward and whether the episode ends")
    next_state, reward, terminated = stepped
    require("the next state of step", next_state, state)
    require("the reward of step", reward, problem.discount)
    require("the termination of step", terminated, jnp.zeros((), bool))
    observation = problem.observe(keys[3], state, action, next_state)
    _require_vector("observe", observation, problem.discount)
    log_likelihood = problem.log_likelihood(observation, state, action, next_state)
    require("log_likelihood", log_likelihood, problem.discount)
    belief = problem.prior(keys[4], state, 1)
    filtered = problem.filter(keys[5], belief, action, observation)
    if (
        not isinstance(filtered, tuple)
        or len(filtered) != 2
        or not isinstance(filtered[0], particles.Particles)
    ):
        _refuse("filter: allowed: two values, the particles and whether none explains the observation")
    for name in ("states", "log_weights", "terminal"):
        require(f"filter: {name}", getattr(filtered[0], name), getattr(belief, name))
    require("filter: the second value", filtered[1], jnp.zeros((), bool))
    if (value := problem.heuristic_value(next_state)) is not None:
        require("heuristic_value", value, problem.discount)
    points = problem.sketch(state)
    sizes = {getattr(x, "shape", None) for x in points.values()} if isinstance(points, dict) else set()
    if sizes not in ({(1,)}, {(2,)}):
        _refuse("sketch: allowed: a dictionary of vectors, all of 1 number or all of 2")


def _require_vector(name: str, value: Float[Array, "N"], example: Float[Array, ""]) -> None:
    if not isinstance(value, Array) or value.ndim != 1:
        _refuse(f"{name} is {described(value)}; allowed: a vector of {example.dtype}")
    require(name, value, jnp.zeros(value.shape, example.dtype))


class _Sample(eqx.Module):
    """Transitions T of random walks, and several observations N of each."""

    is_used: Bool[Array, "T"]  # whether the walk has not ended before
    is_finite: Bool[Array, "T"]  # whether states and rewards are finite, after terminal states too
    is_valued: Bool[Array, "T"]  # whether the heuristic value of the state, if any, is finite
    is_inside: Bool[Array, "T"]  # whether the action is in the action space
    observations: Float[Array, "T N O"]
    own: Float[Array, "T N"]  # log likelihood of the observations
    # Log likelihood of the first observations of each transition, given each other transition
    others: Float[Array, "T T C"]
    far: Float[Array, "T F"]  # log likelihood of observations far from all others
    # Whether no particle explains the first observation of a walk that goes on, and whether the walk goes on
    has_collapsed: Bool[Array, "W"]
    goes_on: Bool[Array, "W"]


def _sample(problem: StateProblem, key: Key[Array, ""]) -> _Sample:
    num_steps = min(_NUM_STEPS, problem.max_steps)
    walk_key, observe_key, particle_key = jax.random.split(key, 3)

    def walk(key: Key[Array, ""]):
        start_key, key = jax.random.split(key)

        def advance(carry, step):
            state, is_used = carry
            action_key, step_key, after_key = jax.random.split(jax.random.fold_in(key, step), 3)
            action = problem.actions.decode(problem.actions.sample(action_key))
            following, reward, ended = problem.step(step_key, state, action)
            # A belief steps terminal particles too.
            after, after_reward, _ = problem.step(after_key, following, action)
            numbers = jnp.concatenate([state, following, after, reward[None], after_reward[None]])
            row = state, action, following, is_used, jnp.all(jnp.isfinite(numbers)), ~ended
            return (following, is_used & ~ended), row

        start = problem.initial(start_key), jnp.asarray(True)
        return jax.lax.scan(advance, start, jnp.arange(num_steps, dtype=jnp.uint32))[1]

    walks = jax.vmap(walk)(jax.random.split(walk_key, _NUM_WALKS))
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), walks)
    states, actions, following, is_used, is_finite, goes_on = rows

    def observe(key: Key[Array, ""], *transition: Float[Array, "..."]) -> Float[Array, "N O"]:
        return jax.vmap(lambda key: problem.observe(key, *transition))(
            jax.random.split(key, _NUM_OBSERVATIONS)
        )

    keys = jax.random.split(observe_key, states.shape[0])
    observations = jax.vmap(observe)(keys, states, actions, following)
    of_several = jax.vmap(problem.log_likelihood, (0, None, None, None))
    of_own = jax.vmap(of_several)
    of_all = jax.vmap(jax.vmap(of_several, (None, 0, 0, 0)), (0, None, None, None))
    distance = 1e3 * (1.0 + jnp.max(observations, axis=(0, 1)) - jnp.min(observations, axis=(0, 1)))
    far = observations[:, :2] + jnp.stack([distance, -distance])[None]

    def has_collapsed(key, action, observation):
        prior_key, update_key = jax.random.split(key)
        belief = particles.initial(problem, prior_key, _NUM_PARTICLES)
        return particles.update(problem, update_key, belief, action, observation)[1]

    def is_valued(state):
        value = problem.heuristic_value(state)
        return jnp.isfinite(0.0 if value is None else value)

    first = slice(None, None, num_steps)
    return _Sample(
        is_used,
        is_finite,
        jax.vmap(is_valued)(states),
        jax.vmap(problem.actions.contains)(actions),
        observations,
        of_own(observations, states, actions, following),
        of_all(observations[:, :_NUM_COMPARED], states, actions, following),
        of_own(far, states, actions, following),
        jax.vmap(has_collapsed)(
            jax.random.split(particle_key, _NUM_WALKS), actions[first], observations[first, 0]
        ),
        goes_on[first],
    )


def _check_numbers(problem: StateProblem) -> None:
    discount = float(problem.discount)
    if not 0.0 < discount <= 1.0:
        _refuse(f"discount is {discount:g}; allowed: above 0, at most 1")
    sample = computed(_sample, problem)
    used = sample.is_used
    if not np.all(sample.is_inside[used]):
        _refuse("actions: a random action is not in the action space; allowed: finite bounds, low first")
    if not np.all(sample.is_finite[used]):
        _refuse(
            "initial or step: a state or a reward is not finite; allowed: finite, after a terminal state too"
        )
    if not np.all(sample.is_valued[used]):
        _refuse("heuristic_value: the value of a state is not finite")
    if not np.all(np.isfinite(sample.observations[used])):
        _refuse("observe: an observation is not finite")
    own, others = sample.own[used], sample.others[used][:, used]
    if np.any(np.isnan(own)) or np.any(np.isnan(others)):
        _refuse("log_likelihood is NaN for an observation that the problem has made")
    if np.any(own == np.inf) or np.any(others == np.inf):
        _refuse("log_likelihood is +inf for an observation that the problem has made")
    # Of a walk that has ended, the particles need not explain anything.
    if np.any(sample.goes_on) and np.all(sample.has_collapsed[sample.goes_on]):
        _refuse(
            f"log_likelihood: none of {_NUM_PARTICLES} particles explains the first observation; "
            "allowed: likelihoods below infinity, and observations with noise or finitely many ones"
        )
    _check_logarithm(sample.observations[used], own, others, sample.far[used])
    _check_fit(own[:, None, :_NUM_COMPARED], others)
    _check_repetition(sample.observations[used], problem.has_discrete_observations)


def _is_turn(widths: Float[np.ndarray, "K"]) -> bool:
    """Whether all ranges are one turn, in radians or degrees."""
    return any(np.allclose(widths, turn, rtol=1e-3) for turn in (2.0 * np.pi, 360.0))


def _check_logarithm(
    observations: Float[np.ndarray, "T N O"],
    own: Float[np.ndarray, "T N"],
    others: Float[np.ndarray, "T T C"],
    far: Float[np.ndarray, "T F"],
) -> None:
    """Refuse a likelihood in place of its logarithm, and one that does not depend on observations."""
    is_finite = True
    for values, logs in zip(observations, own, strict=True):
        distinct, index, counts = np.unique(values, axis=0, return_index=True, return_counts=True)
        if len(distinct) > _MOST_DISTINCT:
            is_finite = False
            continue
        probabilities, shares = np.exp(logs[index]), counts / len(values)
        if not 0.8 < (total := np.sum(probabilities)) < 1.001:
            _refuse(
                f"log_likelihood: the probabilities of {len(distinct)} observations sum to {total:.3g}; "
                "allowed: logarithms of probabilities that sum to 1"
            )
        worst = np.argmax(np.abs(shares - probabilities))
        if np.abs(shares - probabilities)[worst] > _MOST_DIFFERENCE:
            _refuse(
                f"log_likelihood: the observation {distinct[worst].tolist()} has the probability "
                f"{probabilities[worst]:.3g}, but observe returns it in {shares[worst]:.0%} of draws"
            )
    if is_finite:
        return
    # Where a density is undefined, far from all observations, a logarithm may be anything.
    if min(own.min(), others.min(), np.nanmin(far, initial=np.inf)) >= 0.0:
        _refuse(
            "log_likelihood is never negative, even far from all observations; "
            "allowed: the logarithm of the density, not the density"
        )
    if np.all(own == own[:, :1]) and np.all(far == own[:, :1]):
        _refuse("log_likelihood is the same for all observations; allowed: a density of the observation")


def _check_fit(own: Float[np.ndarray, "T 1 C"], others: Float[np.ndarray, "T T C"]) -> None:
    """Refuse a likelihood under which observations come from other transitions than those that made them.

    For independent observations of transition i, the ratio of their joint density after any transition to
    that after i has an expectation of at most 1. By Markov's inequality, the mean of these ratios exceeds
    1,000 for one correct problem in 1,000 at most.
    """
    with np.errstate(invalid="ignore"):
        logs = np.nan_to_num(np.sum(others - own, axis=-1), nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    ratio = np.logaddexp.reduce(logs, axis=None) - np.log(logs.size)
    if ratio > np.log(_MOST_RATIO):
        _refuse(
            "log_likelihood does not fit observe: observations are likelier after other steps than after the "
            "step that made them"
        )


def _check_repetition(observations: Float[np.ndarray, "T N O"], is_discrete: bool) -> None:
    """Refuse a declaration that contradicts whether observations repeat."""
    num_steps, num_draws, size = observations.shape
    number = len(np.unique(observations.reshape(-1, size), axis=0))
    # An observation without noise has one value for each step, and need not repeat.
    if number <= num_steps // 2 and not is_discrete:
        _refuse(
            f"observe: {num_steps * num_draws} observations have {number} values; allowed: "
            "has_discrete_observations = True in the class"
        )
    if is_discrete and number == num_steps * num_draws:
        _refuse("has_discrete_observations is True, but no observation comes again; allowed: False")


def _refuse(message: str) -> NoReturn:
    raise Misfit(message)
