"""A check of a user's learner and schedule by tracing each of their methods once."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from bojax.envs.spaces import Space
from bojax.learning.base import Episode, ExplorationState, Learner, Transition
from bojax.learning.schedules import Schedule
from bojax.numerics.trial import Misfit, described, is_users, require, require_arrays, require_state, trial


def check_weight(learner: Learner) -> None:
    """Check that a learner has an exploration weight, whose precision is that of the run.

    Raises:
        ValueError: The property raises an exception, or is not a scalar array.
    """
    if _is_own(learner):
        require_arrays(learner)
    trial(learner, _check_weight)


def check_learner(learner: Learner, observations: Space, actions: Space) -> None:
    """Check what the methods of a learner return, if it or a part of it is a class of a user.

    Raises:
        ValueError: A method raises an exception, or returns something that does not fit.
    """
    if not (parts := [part for part in jax.tree.leaves(learner, is_leaf=_is_own) if _is_own(part)]):
        return
    fitted = learner.fitted(observations, actions)
    for own in parts:
        require_arrays(own)
        trial(own, _check_methods, fitted, observations, actions, jax.random.key(0))


def check_schedule(schedule: Schedule) -> None:
    """Check the exploration state that a schedule of a user returns.

    Raises:
        ValueError: The schedule raises an exception, or returns something that does not fit.
    """
    if _is_own(schedule):
        require_arrays(schedule)
    trial(schedule, _check_exploration)


def _is_own(part: Any) -> bool:
    """Whether a part of a learner is a module whose class does not belong to bojax."""
    return isinstance(part, eqx.Module) and is_users(part)


def _check_weight(learner: Learner) -> None:
    _require_number("exploration_weight", learner.exploration_weight)
    if not isinstance(learner.block, int) or learner.block < 1:
        raise Misfit(f"block is {learner.block}; allowed: an integer >= 1")


def _check_methods(
    own: Any, learner: Learner, observations: Space, actions: Space, key: Key[Array, ""]
) -> None:
    """Check all methods of a learner; `own` is the part of it that is a class of a user."""
    number = jnp.zeros_like(learner.exploration_weight)
    zero, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
    exploration = ExplorationState(number, no)
    observation, action = observations.example, actions.example
    state = learner.init(key, observations, actions, learner.block)
    for path, leaf in jax.tree.leaves_with_path(state):
        if isinstance(leaf, int | float):
            require(f"state{jax.tree_util.keystr(path)} of init", leaf, jnp.asarray(leaf, number.dtype))
    state = jax.tree.map(jnp.asarray, state)

    acted = learner.act(key, state, observation, exploration)
    if not (isinstance(acted, tuple) and len(acted) == 2):
        raise Misfit(f"act returns {described(acted)}; allowed: an action and the return expected of it")
    require("the action of act", acted[0], action)
    require("the expected return of act", acted[1], number)

    transition = Transition(observation, action, number, observation, no)
    require_state("observe", learner.observe(key, state, transition, exploration, zero), state)
    require_state("flush", learner.flush(state), state)
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x, (learner.block, *x.shape)), transition)
    episode = Episode(rows, zero)
    require_state("end_episode", learner.end_episode(key, state, episode, exploration), state)

    values = learner.values(state, observation, action)
    if not (isinstance(values, tuple) and len(values) == 2):
        raise Misfit(f"values returns {described(values)}; allowed: Q and U")
    for name, value in zip(("Q", "U"), values, strict=True):
        require(f"{name} of values", value, number)


def _check_exploration(schedule: Schedule) -> None:
    exploration = schedule(jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    if not isinstance(exploration, ExplorationState):
        raise Misfit(f"returns {described(exploration)}; allowed: an ExplorationState")
    _require_number("ExplorationState.scale", exploration.scale)
    require("ExplorationState.is_learning", exploration.is_learning, jnp.zeros((), bool))


def _require_number(name: str, value: Any) -> None:
    """Raise a `Misfit` unless a value is a number of any precision."""
    if not (isinstance(value, Array) and value.shape == () and jnp.issubdtype(value.dtype, jnp.floating)):
        raise Misfit(f"{name} is {described(value)}; allowed: floating-point of shape ()")
