"""Spaces of Gymnasium as boxes of vectors and finite sets, and the conversion of their values.

Observations become vectors as `gymnasium.spaces.utils.flatten` makes them: what is discrete is one-hot. An
action of several discrete parts is an integer that counts their combinations: a learner that chose each
number of a one-hot vector by itself would choose vectors that are no actions.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.config.extras import needed
from bojax.envs.adapter import Adapter
from bojax.envs.spaces import Box, Discrete, Space
from bojax.numerics.trial import Misfit
from bojax.text import one_line

with needed("gymnasium", "gym"):
    from gymnasium import Space as GymnasiumSpace
    from gymnasium import spaces
    from gymnasium.spaces.utils import flatten, flatten_space, unflatten

_INFINITE = 1e30
"""Bounds from here on count as infinite, since some environments declare the largest 32-bit number."""

REAL = "biuf"
"""Kinds of NumPy's dtypes of real numbers."""

MAX_COMBINATIONS = 4096
"""Largest number of combinations of discrete actions: learners compute the value of each."""

_FINITE = spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary


class GymnasiumAdapter(Adapter):
    """Converts between values of Gymnasium's spaces, of observations and of actions, and those of bojax."""

    def __init__(
        self, spaces: tuple[GymnasiumSpace[Any], GymnasiumSpace[Any]], observations: Space, actions: Space
    ):
        super().__init__(observations, actions)
        self._observation, self._action = spaces

    @override
    def observation(self, value: Any, origin: str = "got") -> Any:
        """The observation as an integer from 0 or a vector of 32-bit numbers.

        Raises:
            Misfit: It does not fit its space; `origin` begins the message.
        """
        space: Any = self._observation
        for path, part, found in _values(space, value, origin):
            found = _checked(part, found, f"{origin} an observation" + (f" with {path}" if path else ""))
            if space is part and isinstance(space, spaces.Box):
                return found.astype(np.float32).ravel()
            if space is part and isinstance(space, spaces.Discrete):
                return int(found - space.start)
        return np.asarray(flatten(space, value), np.float32)

    @override
    def action(self, value: Any) -> Any:
        """The action as Gymnasium has it: within its bounds, whole numbers in boxes of integers."""
        space: Any = self._action
        if isinstance(space, spaces.Discrete):
            return space.dtype.type(np.clip(value, 0, space.n - 1) + space.start)
        found = [part for _, part in _parts(space)]
        if isinstance(self.actions, Discrete):
            return unflatten(space, _combination(found, int(np.clip(value, 0, self.actions.num - 1))))
        flat: Any = flatten_space(space)
        whole = [np.full(math.prod(part.shape), np.issubdtype(part.dtype, np.integer)) for part in found]
        value = np.asarray(value).ravel()
        value = np.where(np.concatenate(whole), np.rint(value), value)  # a cast alone would round towards 0
        return unflatten(space, np.clip(value, flat.low, flat.high))


def from_gymnasium(
    space: GymnasiumSpace[Any],
    what: str,
    dtype: Any,
    low: Float[Array, "..."] | None = None,
    high: Float[Array, "..."] | None = None,
) -> Space:
    """Convert a space of Gymnasium, by its own flattening where it is neither a box nor discrete.

    A box with several axes becomes a box of vectors. So do dictionaries and tuples, and observations of
    several discrete parts, which are one-hot. An action of several discrete parts becomes discrete, with one
    element for each combination.

    `what` is `"observation"` or `"action"`, and the given bounds replace the declared ones.

    Raises:
        ValueError: The space cannot be flattened, or an action has discrete and continuous parts, or too many
            combinations; a bound is infinite or of the wrong size; a lower bound is not below the upper one.
    """
    if isinstance(space, spaces.Discrete):
        return Discrete(int(space.n))
    found = [*_parts(space)]
    for path, part in found:
        if not isinstance(part, spaces.Box | _FINITE):
            where = f", whose part {path} is {one_line(part)}" if path else ""
            allowed = "boxes, discrete spaces, and dictionaries and tuples of them"
            raise ValueError(f"{what} space {one_line(space)}{where}: cannot be a vector; allowed: {allowed}")
    is_finite = [isinstance(part, _FINITE) for _, part in found]
    if what == "action" and any(is_finite):
        if not all(is_finite):
            allowed = "discrete parts alone, or boxes alone"
            raise ValueError(f"action space {one_line(space)}: mixes both; allowed: {allowed}")
        num = math.prod(size for _, part in found for size in _sizes(part))
        if num > MAX_COMBINATIONS:
            allowed = f"at most {MAX_COMBINATIONS:,}"
            raise ValueError(f"action space {one_line(space)}: {num:,} combinations; allowed: {allowed}")
        return Discrete(num)
    return _box(space, what, dtype, low, high)


def as_action(space: Space, given: Any, *lanes: int) -> Array:
    """An action that a user gives, or one for each of the lanes, as an array of its space.

    Elements of a discrete space that are already on the device are not fetched to be checked.

    Raises:
        ValueError: It has another shape, or is no element of a discrete space.
    """
    example = space.example
    action, shape = given if isinstance(given, Array) else np.asarray(given), (*lanes, *example.shape)
    if action.shape != shape:
        raise ValueError(f"action: got an array of shape {action.shape}; allowed: {shape}")
    if isinstance(space, Discrete):
        is_known = action.dtype.kind in "biu"
        if is_known and isinstance(action, np.ndarray):
            is_known = bool(np.all((action >= 0) & (action < space.num)))
        if not is_known:
            raise ValueError(f"action: got {given}; allowed: integers from 0 to {space.num - 1}")
    return jnp.asarray(action, example.dtype)


def to_gymnasium(space: Space) -> GymnasiumSpace[Any]:
    """Convert a space of bojax; the bounds of a box become 32-bit numbers."""
    if isinstance(space, Discrete):
        return spaces.Discrete(space.num)
    return spaces.Box(np.asarray(space.low, np.float32), np.asarray(space.high, np.float32))


def _box(
    space: GymnasiumSpace[Any],
    what: str,
    dtype: Any,
    low: Float[Array, "..."] | None,
    high: Float[Array, "..."] | None,
) -> Box:
    """The box of the flat vectors of a space."""
    flat: Any = flatten_space(space)
    size, bounds = math.prod(flat.shape), []
    for name, declared, given in (("low", flat.low, low), ("high", flat.high, high)):
        if given is None:
            bound = np.asarray(declared, np.float64).ravel()
        elif given.shape not in ((), (size,)):
            raise ValueError(f"{name}: got {given.size} numbers; there are {size} in an {what}")
        else:
            bound = np.broadcast_to(np.asarray(given, np.float64), (size,))
        bounds.append(bound)
    wide = ~(np.abs(bounds) < _INFINITE).all(axis=0)
    if wide.any():
        where = ", ".join(map(str, np.flatnonzero(wide)))
        remedy = (
            f"set low and high, such as high={[1.0] * min(size, 9)}"
            if what == "observation"
            else "an action needs finite ones"
        )
        raise ValueError(f"{what} space has infinite bounds (component {where}): {remedy}")
    if not np.all(bounds[0] < bounds[1]):
        where = ", ".join(map(str, np.flatnonzero(~(bounds[0] < bounds[1]))))
        raise ValueError(f"{what} space: low is not below high (component {where})")
    return Box(jnp.asarray(bounds[0], dtype), jnp.asarray(bounds[1], dtype))


def _members(space: Any) -> list[tuple[Any, Any]] | None:
    """Keys and spaces of a dictionary or a tuple; None of any other space."""
    if isinstance(space, spaces.Dict):
        return [*space.spaces.items()]
    return [*enumerate(space.spaces)] if isinstance(space, spaces.Tuple) else None


def _parts(space: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The spaces that a space consists of, in the order in which they are flattened, with their paths."""
    if (members := _members(space)) is None:
        yield path, space
        return
    for key, part in members:
        yield from _parts(part, f"{path}.{key}".removeprefix("."))


def _values(space: Any, value: Any, origin: str, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """The path, the space and the value of each part of a value.

    Raises:
        Misfit: A dictionary or a tuple has other members than its space.
    """
    if (members := _members(space)) is None:
        yield path, space, value
        return
    has_keys = isinstance(space, spaces.Dict)
    keys: list[Any] | None = [*value] if has_keys and isinstance(value, Mapping) else None
    if not has_keys and isinstance(value, tuple | list):
        keys = [*range(len(value))]
    if keys is None or {*keys} != {key for key, _ in members}:
        allowed = ", ".join(str(key) for key, _ in members) if has_keys else f"{len(members)} values"
        found = type(value).__name__ if keys is None else ", ".join(map(str, keys)) if has_keys else len(keys)
        where = f" in {path}" if path else ""
        raise Misfit(f"{origin} an observation{where} with {found}; allowed: {allowed}")
    for key, part in members:
        yield from _values(part, value[key], origin, f"{path}.{key}".removeprefix("."))


def _checked(space: Any, value: Any, got: str) -> np.ndarray:
    """A value of a box or a discrete space as an array.

    Raises:
        Misfit: Its type or shape is another one, or it is not an element of a discrete space.
    """
    try:
        found = np.asarray(value)
    except ValueError as error:  # nested lists of unequal lengths
        raise Misfit(f"{got} that is no array") from error
    is_finite = isinstance(space, _FINITE)
    if found.dtype.kind not in ("iu" if is_finite else REAL) and not (
        isinstance(space, spaces.MultiBinary) and found.dtype.kind == "b"
    ):
        raise Misfit(f"{got} of dtype {found.dtype}; allowed: {'integers' if is_finite else 'numbers'}")
    if found.shape != space.shape:
        raise Misfit(f"{got} of shape {found.shape}, not {space.shape}")
    if isinstance(space, spaces.Discrete) and not space.start <= found < space.start + space.n:
        raise Misfit(f"{got} of {found}; allowed: {space.start} to {space.start + space.n - 1}")
    if is_finite and not isinstance(space, spaces.Discrete) and not space.contains(found.astype(space.dtype)):
        raise Misfit(f"{got} of {one_line(found)}; allowed: an element of {one_line(space)}")
    return found


def _sizes(space: Any) -> list[int]:
    """Numbers of elements of the discrete parts of a discrete space."""
    if isinstance(space, spaces.Discrete):
        return [int(space.n)]
    if isinstance(space, spaces.MultiBinary):
        return [2] * math.prod(space.shape)
    return [int(num) for num in np.ravel(space.nvec)]


def _combination(found: list[Any], index: int) -> np.ndarray:
    """The flat vector of the combination of a number; the last discrete part changes fastest."""
    sizes = [size for part in found for size in _sizes(part)]
    digits = iter(np.unravel_index(index, sizes))
    vectors = []
    for part in found:
        for size in _sizes(part):
            digit = int(next(digits))
            is_binary = isinstance(part, spaces.MultiBinary)
            vectors.append([digit] if is_binary else np.arange(size) == digit)
    return np.concatenate(vectors).astype(np.int64)
