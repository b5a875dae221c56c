"""A check of a user's environment: its first step is traced, and nothing is computed."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, DTypeLike, Float, Key

from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box, Discrete, Space
from bojax.text import error_at_line


def check_env(env: Env, dtype: DTypeLike) -> None:
    """Check that spaces, states and time steps have the shapes and the precision that a run needs.

    Environments of bojax are not checked, nor those that step on the host.

    Args:
        env: The environment.
        dtype: Precision of the run.

    Raises:
        ValueError: A method raises an exception, or returns something that does not fit. The message begins
            with the name of the setting, `env`.
    """
    if env.is_hosted or type(env).__module__.startswith("bojax."):
        return
    try:
        # JAX caches the trace, which the points of a sweep share if they differ only in numbers.
        jax.eval_shape(_check_step, env, jax.random.key(0), jnp.zeros((), dtype))
    except _MisfitError as error:
        raise ValueError(f"env: {type(env).__name__}: {error}") from error
    except Exception as error:  # a user's class may raise anything
        message = error_at_line(error)
        raise ValueError(f"env: {type(env).__name__}: its first step failed: {message}") from error


class _MisfitError(Exception):
    """What does not fit, and what would."""


def _check_step(env: Env, key: Key[Array, ""], number: Float[Array, ""]) -> None:
    """Check the first step of an episode; `number` has the precision of the run."""
    _check_space("observation_space", env.observation_space, number.dtype)
    _check_space("action_space", env.action_space, number.dtype)
    state = env.of_run(key).reset(key)
    observed = env.observe(state)
    _check("the observation of observe", observed, env.observation_space.example)
    result = env.step(key, state, env.action_space.example)
    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], TimeStep)):
        raise _MisfitError("step has to return the next state and a TimeStep")
    after, step = result
    _check("TimeStep.observation", step.observation, observed)
    _check("TimeStep.reward", step.reward, number)
    for name in ("terminated", "truncated", "success"):
        _check(f"TimeStep.{name}", getattr(step, name), jnp.zeros((), bool))
    if jax.tree.structure(state) != jax.tree.structure(after):
        raise _MisfitError("the states of reset and step differ in structure")
    for (path, leaf), other in zip(jax.tree.leaves_with_path(state), jax.tree.leaves(after), strict=True):
        _check(f"state{jax.tree_util.keystr(path)} of step", other, jnp.asarray(leaf))


def _check_space(name: str, space: Space, dtype: jnp.dtype) -> None:
    if isinstance(space, Discrete):
        return
    if not isinstance(space, Box):
        raise _MisfitError(f"{name} is a {type(space).__name__}; allowed: Box or Discrete")
    if jnp.ndim(space.low) != 1:
        raise _MisfitError(
            f"{name}: low has shape {jnp.shape(space.low)}; allowed: a number for each dimension"
        )
    for bound in ("low", "high"):
        _check(f"{name}.{bound}", getattr(space, bound), jnp.zeros(space.low.shape, dtype))


def _check(name: str, value: Any, expected: Array) -> None:
    """Refuse a value of another shape or type than expected."""
    if isinstance(value, Array) and (value.shape, value.dtype) == (expected.shape, expected.dtype):
        return
    got = f"{value.dtype} of shape {value.shape}" if isinstance(value, Array) else type(value).__name__
    is_precision = jnp.shape(value) == expected.shape and jnp.issubdtype(expected.dtype, jnp.floating)
    hint = (
        "; convert it to the dtype of a setting, as in jnp.asarray(x, self.speed.dtype)"
        if is_precision
        else ""
    )
    raise _MisfitError(f"{name} is {got}; allowed: {expected.dtype} of shape {expected.shape}{hint}")
