"""A check of a user's learner and schedule: traces of each method, and calls that must change nothing."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from bojax.envs.spaces import Discrete, Space
from bojax.learning.base import Episode, ExplorationState, Learner, Transition
from bojax.learning.schedules import Schedule
from bojax.models.checks import is_known
from bojax.numerics.simulation_keys import is_key
from bojax.numerics.trial import (
    Misfit,
    computed,
    described,
    is_users,
    require,
    require_arrays,
    require_columns,
    require_state,
    trial,
    trial_of,
)
from bojax.text import error_at_line


def check_weight(learner: Learner) -> None:
    """Check that a learner has an exploration weight, whose precision is that of the run.

    Raises:
        ValueError: The property raises an exception, or is not a scalar array.
    """
    if _is_own(learner):
        require_arrays(learner)
    trial(learner, _check_weight)


def check_spaces(learner: Learner, observations: Space, actions: Space) -> None:
    """Ask a learner whether it can be used for an environment.

    Raises:
        ValueError: It cannot, or its method raises another exception.
    """
    try:
        learner.check_spaces(observations, actions)
    except ValueError:
        raise
    except Exception as error:  # a user's class may raise anything
        name = type(learner).__name__
        raise ValueError(f"learner: {name}: check_spaces failed: {error_at_line(error)}") from error


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
    if _is_own(learner) and is_known(fitted):
        with trial_of(type(learner).__name__):
            _check_idle(fitted, observations, actions)


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

    given = _copy(state)
    leaves = jax.tree.leaves(given)
    acted = learner.act(key, given, observation, exploration)
    if any(after is not leaf for after, leaf in zip(jax.tree.leaves(given), leaves, strict=False)):
        raise Misfit("act changes its state in place; allowed: observe and end_episode return a new one")
    if not (isinstance(acted, tuple) and len(acted) == 2):
        raise Misfit(f"act returns {described(acted)}; allowed: an action and the return expected of it")
    require("the action of act", acted[0], action)
    require("the expected return of act", acted[1], number)

    transition = Transition(observation, action, number, observation, no)
    require_state("observe", learner.observe(key, _copy(state), transition, exploration, zero), state)
    require_state("flush", learner.flush(_copy(state)), state)
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x, (learner.block, *x.shape)), transition)
    episode = Episode(rows, zero)
    require_state("end_episode", learner.end_episode(key, _copy(state), episode, exploration), state)

    values = learner.values(state, observation, action)
    if not (isinstance(values, tuple) and len(values) == 2):
        raise Misfit(f"values returns {described(values)}; allowed: Q and U")
    for name, value in zip(("Q", "U"), values, strict=True):
        require(f"{name} of values", value, number)
    if _is_own(learner):
        require_columns("summary", learner.summary(state), "columns", learner.columns)


def _check_idle(learner: Learner, observations: Space, actions: Space) -> None:
    """Refuse methods that change what they must not, and actions outside of the space or changed by saving.

    `observe`, `flush` and `end_episode` are also called for runs that have ended, until all runs of the batch
    have: what a run learned would depend on the others.
    """
    state, afters, acted = computed(_idle, learner, observations, actions)
    for method, after in afters.items():
        same = jax.tree.map(lambda *two: np.array_equal(*two, equal_nan=True), after, state)
        if not all(jax.tree.leaves(same)):
            when = "nothing is pending" if method == "flush" else "exploration.is_learning is false"
            raise Misfit(f"{method} changes the state although {when}; allowed: the same state")
    if not np.array_equal(*acted, equal_nan=True):
        raise Misfit("act takes another action in what policy_state exports; allowed: the same action")
    if isinstance(actions, Discrete) and not 0 <= acted[0] < actions.num:
        raise Misfit(f"act takes the action {acted[0]}; allowed: 0 to {actions.num - 1}")


def _idle(learner: Learner, observations: Space, actions: Space, key: Key[Array, ""]) -> Any:
    """A state, those after calls that must not change it, and the actions in it and in what is exported."""
    number, zero = jnp.ones_like(learner.exploration_weight), jnp.zeros((), jnp.int32)
    learns, idles = (ExplorationState(number, jnp.asarray(flag)) for flag in (True, False))
    keys = jax.random.split(key, 9)
    before, after = observations.sample(keys[0]), observations.sample(keys[1])
    transition = Transition(before, actions.sample(keys[2]), number, after, jnp.zeros((), bool))
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x, (learner.block, *x.shape)), transition)
    episode = Episode(rows, zero + 1)
    state = learner.init(keys[3], observations, actions, learner.block)
    state = learner.flush(learner.observe(keys[4], state, transition, learns, zero))
    state = learner.end_episode(keys[5], state, episode, learns)
    afters = {
        "flush": learner.flush(_copy(state)),
        "observe": learner.observe(keys[6], _copy(state), transition, idles, zero),
        "end_episode": learner.end_episode(keys[7], _copy(state), episode, idles),
    }
    exported, own_key = learner.policy_state(_copy(state)), keys[8]
    acted = learner.act(jax.random.clone(own_key), exported, before, idles)[0]
    numbers = jax.tree.map(lambda x: jax.random.key_data(x) if is_key(x) else x, (state, afters))
    return *numbers, (learner.act(own_key, _copy(state), before, idles)[0], acted)


def _copy(state: Any) -> Any:
    """The same arrays in containers of their own, which a method may change in place."""
    return jax.tree.map(lambda x: jax.random.clone(x) if is_key(x) else x, state)


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
