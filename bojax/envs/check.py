"""A check of a user's environment by tracing its first step."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float, Key

from bojax.envs.base import Env, EnvState, TimeStep
from bojax.envs.spaces import Box, Discrete, Space
from bojax.numerics.trial import (
    Misfit,
    is_users,
    require,
    require_arrays,
    require_columns,
    require_equal_traces,
    require_state,
    trial,
    trial_of,
)


def check_env(env: Env, dtype: DTypeLike) -> None:
    """Check that spaces, states and time steps have the shapes and the precision that a run needs.

    Of environments of bojax, only the bounds are checked. Environments that step on the host are not checked.

    Raises:
        ValueError: A method raises an exception, or returns something that does not fit.
    """
    if env.is_hosted:
        return
    require_arrays(env)
    trial(env, _check_step, jax.random.key(0), jnp.zeros((), dtype))
    if is_users(env):
        with trial_of(type(env).__name__):
            require_equal_traces(_stepped, env)
    _check_bounds("observation_space", env.observation_space)
    _check_bounds("action_space", env.action_space)


def interface_env(env: Env) -> Env:
    """The environment that an interface of another library steps, with properties of a run from key 0.

    Raises:
        ValueError: It is not an environment of bojax, or steps on the host.
    """
    if not isinstance(env, Env):
        raise ValueError(f'env: got {env!r:.60}; allowed: an environment, such as bojax.part("mountain-car")')
    if env.is_hosted:
        raise ValueError(f"{type(env).__name__}: is stepped on the host; allowed: a compiled environment")
    return env.of_run(jax.random.key(0))


def _check_step(env: Env, key: Key[Array, ""], number: Float[Array, ""]) -> None:
    """Check the first step of an episode; `number` has the precision of the run."""
    if not isinstance(env.max_steps, int) or env.max_steps < 1:
        raise Misfit(f"max_steps is {env.max_steps}; allowed: an integer >= 1")
    _check_space("observation_space", env.observation_space, number.dtype)
    _check_space("action_space", env.action_space, number.dtype)
    state = env.of_run(key).reset(key)
    observed = env.observe(state)
    require("the observation of observe", observed, env.observation_space.example)
    frame = env.frame(state)
    if frame is not None and jnp.ndim(frame) != 1:
        raise Misfit(f"frame has shape {jnp.shape(frame)}; allowed: a vector")
    require_columns("counts", env.counts(state), "count_columns", env.count_columns)
    result = env.step(key, state, env.action_space.example)
    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], TimeStep)):
        raise Misfit("step has to return the next state and a TimeStep")
    after, step = result
    require("TimeStep.observation", step.observation, observed)
    require("TimeStep.reward", step.reward, number)
    for name in ("terminated", "truncated", "success"):
        require(f"TimeStep.{name}", getattr(step, name), jnp.zeros((), bool))
    require_state("step", after, state)


def _stepped(env: Env, key: Key[Array, ""]) -> tuple[EnvState, TimeStep]:
    """The first step of an episode."""
    keys = jax.random.split(key)
    return env.step(keys[0], env.reset(keys[1]), env.action_space.example)


def _check_space(name: str, space: Space, dtype: jnp.dtype) -> None:
    if isinstance(space, Discrete):
        if not isinstance(space.num, int | np.integer) or space.num < 1:
            raise Misfit(f"{name}.num is {space.num}; allowed: an integer >= 1")
        return
    if not isinstance(space, Box):
        raise Misfit(f"{name} is a {type(space).__name__}; allowed: Box or Discrete")
    if jnp.ndim(space.low) != 1:
        shape = jnp.shape(space.low)
        raise Misfit(f"{name}.low has shape {shape}; allowed: one number for each dimension")
    for bound in ("low", "high"):
        require(f"{name}.{bound}", getattr(space, bound), jnp.zeros(space.low.shape, dtype))


def _check_bounds(name: str, space: Space) -> None:
    """Refuse bounds that observations or actions cannot be scaled by."""
    if isinstance(space, Discrete):
        return
    for i, (low, high) in enumerate(zip(np.asarray(space.low), np.asarray(space.high), strict=True)):
        if not (low < high and np.isfinite(high - low)):
            raise ValueError(f"{name}: component {i} is from {low} to {high}; allowed: finite, low < high")
