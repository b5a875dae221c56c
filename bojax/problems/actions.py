"""Action spaces of state problems: planners search parameters in [-1, 1]^P, problems act on arrays."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Num
from typing_extensions import override

from bojax.numerics.trial import described


class ActionSpace(eqx.Module):
    """The actions of a problem, and the parameters by which a planner names them."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Number of parameters."""

    @abc.abstractmethod
    def decode(self, parameters: Num[Array, "P"]) -> Float[Array, "K"]:
        """The action of parameters in [-1, 1]; those of `Discrete` are an index."""

    @abc.abstractmethod
    def encode(self, action: Float[Array, "K"]) -> Num[Array, "P"]:
        """Parameters of an action of the space."""

    @abc.abstractmethod
    def sample(self, key: Key[Array, ""]) -> Num[Array, "P"]:
        """Parameters of a random action."""

    @abc.abstractmethod
    def contains(self, action: Float[Array, "K"]) -> Bool[Array, ""]:
        """Whether an action, decoded, belongs to the space."""

    def coordinates(self, parameters: Num[Array, "P"]) -> Float[Array, "C"]:
        """Coordinates in which close actions are alike, for kernels; an angle is a point on a circle."""
        return parameters

    def level(self, parameters: Num[Array, "P"]) -> Int[Array, ""]:
        """The index of the action's level, which coordinates do not have; 0 in a space without levels."""
        return jnp.zeros((), jnp.int32)


class Box(ActionSpace):
    """Vectors between two bounds; a random action is uniform.

    Attributes:
        low: Lower bounds.
        high: Upper bounds.
        is_angle: Whether every component is an angle, with bounds that are one turn apart.
    """

    low: Float[Array, "K"]
    high: Float[Array, "K"]
    is_angle: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        shapes = [getattr(bound, "shape", ()) for bound in (self.low, self.high)]
        if len(shapes[0]) != 1 or shapes[0] != shapes[1]:
            got = " and ".join(map(described, (self.low, self.high)))
            raise ValueError(
                f"Box: got {got}; allowed: two vectors of one length, as arrays with the dtype of a field"
            )

    @property
    @override
    def size(self) -> int:
        return self.low.shape[0]

    @override
    def decode(self, parameters: Float[Array, "K"]) -> Float[Array, "K"]:
        return self.low + 0.5 * (parameters + 1.0) * (self.high - self.low)

    @override
    def encode(self, action: Float[Array, "K"]) -> Float[Array, "K"]:
        return 2.0 * (action - self.low) / (self.high - self.low) - 1.0

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "K"]:
        return jax.random.uniform(key, self.low.shape, self.low.dtype, -1.0, 1.0)

    @override
    def contains(self, action: Float[Array, "K"]) -> Bool[Array, ""]:
        # The rounding of `decode`: at a bound, it may exceed it.
        slack = 4.0 * jnp.finfo(self.low.dtype).eps * jnp.maximum(jnp.abs(self.low), jnp.abs(self.high))
        is_inside = (self.low - slack <= action) & (action <= self.high + slack)
        return jnp.all(is_inside & jnp.isfinite(action))

    @override
    def coordinates(self, parameters: Float[Array, "K"]) -> Float[Array, "C"]:
        if not self.is_angle:
            return parameters
        return jnp.concatenate([jnp.cos(jnp.pi * parameters), jnp.sin(jnp.pi * parameters)])


class Discrete(ActionSpace):
    """A finite list of actions; the only parameter is an index, and a random action is uniform.

    Attributes:
        values: The actions.
    """

    values: Float[Array, "A K"]

    def __check_init__(self) -> None:
        if getattr(self.values, "ndim", 0) != 2 or not self.values.shape[0]:
            raise ValueError(
                "Discrete: allowed: an array with a row of numbers for each action, such as jnp.eye(3)"
            )

    @property
    @override
    def size(self) -> int:
        return 1

    @property
    def count(self) -> int:
        """Number of actions."""
        return self.values.shape[0]

    @override
    def decode(self, parameters: Num[Array, "1"]) -> Float[Array, "K"]:
        return self.values[parameters[0].astype(jnp.int32)]

    @override
    def encode(self, action: Float[Array, "K"]) -> Int[Array, "1"]:
        return jnp.argmax(jnp.all(self.values == action[None], axis=1))[None].astype(jnp.int32)

    @override
    def sample(self, key: Key[Array, ""]) -> Int[Array, "1"]:
        return jax.random.randint(key, (1,), 0, self.count, jnp.int32)

    @override
    def contains(self, action: Float[Array, "K"]) -> Bool[Array, ""]:
        return jnp.any(jnp.all(self.values == action[None], axis=1))

    @override
    def coordinates(self, parameters: Num[Array, "1"]) -> Float[Array, "0"]:
        return jnp.zeros((0,), self.values.dtype)

    @override
    def level(self, parameters: Num[Array, "1"]) -> Int[Array, ""]:
        return parameters[0].astype(jnp.int32)


class Mixed(ActionSpace):
    """A vector of a box, then one of a few levels: [-1, 1] is divided equally among the levels.

    Attributes:
        box: Space of the vector.
        levels: Values of the last component.
    """

    box: Box
    levels: Float[Array, "L"]

    def __check_init__(self) -> None:
        shape, dtype = getattr(self.levels, "shape", ()), getattr(self.levels, "dtype", None)
        if not isinstance(self.box, Box) or len(shape) != 1 or not shape[0] or dtype != self.box.low.dtype:
            got = f"{type(self.box).__name__} and {described(self.levels)}"
            raise ValueError(f"Mixed: got {got}; allowed: a Box, and a vector of levels with its dtype")

    @property
    @override
    def size(self) -> int:
        return self.box.size + 1

    @override
    def decode(self, parameters: Float[Array, "K"]) -> Float[Array, "K"]:
        return jnp.append(self.box.decode(parameters[:-1]), self.levels[self.level(parameters)])

    @override
    def coordinates(self, parameters: Float[Array, "K"]) -> Float[Array, "C"]:
        return self.box.coordinates(parameters[:-1])

    @override
    def level(self, parameters: Float[Array, "K"]) -> Int[Array, ""]:
        count = self.levels.shape[0]
        level = jnp.ceil(0.5 * (parameters[-1] + 1.0) * count).astype(jnp.int32) - 1
        return jnp.clip(level, 0, count - 1)

    @override
    def encode(self, action: Float[Array, "K"]) -> Float[Array, "K"]:
        level = jnp.argmax(self.levels == action[-1]).astype(action.dtype)
        return jnp.append(self.box.encode(action[:-1]), (2.0 * level + 1.0) / self.levels.shape[0] - 1.0)

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "K"]:
        return jax.random.uniform(key, (self.size,), self.levels.dtype, -1.0, 1.0)

    @override
    def contains(self, action: Float[Array, "K"]) -> Bool[Array, ""]:
        return self.box.contains(action[:-1]) & jnp.any(self.levels == action[-1])


class Balls(ActionSpace):
    """One vector of bounded length for each agent; a random action is uniform in the balls.

    Attributes:
        radius: Greatest length of a vector.
        num_agents: Number of agents.
        num_dims: Components of a vector.
    """

    radius: Float[Array, ""]
    num_agents: int = eqx.field(static=True)
    num_dims: int = eqx.field(static=True)

    @property
    @override
    def size(self) -> int:
        return self.num_agents * self.num_dims

    @override
    def decode(self, parameters: Float[Array, "K"]) -> Float[Array, "K"]:
        # Along each ray from the centre, the cube is scaled to the ball.
        vectors = self._vectors(parameters)
        return (vectors * self.radius * _ratio(_largest(vectors), _length(vectors))).ravel()

    @override
    def encode(self, action: Float[Array, "K"]) -> Float[Array, "K"]:
        vectors = self._vectors(action) / self.radius
        return (vectors * _ratio(_length(vectors), _largest(vectors))).ravel()

    @override
    def sample(self, key: Key[Array, ""]) -> Float[Array, "K"]:
        # Not `jax.random.ball`, which draws one vector after the other for the keys of a search.
        key_direction, key_length = jax.random.split(key)
        normal = jax.random.normal(key_direction, (self.num_agents, self.num_dims), self.radius.dtype)
        length = jax.random.uniform(key_length, (self.num_agents, 1), normal.dtype) ** (1.0 / self.num_dims)
        return (normal * _ratio(length, _largest(normal))).ravel()

    @override
    def contains(self, action: Float[Array, "K"]) -> Bool[Array, ""]:
        tolerance = 8.0 * jnp.finfo(self.radius.dtype).eps
        return jnp.all(_length(self._vectors(action)) <= self.radius * (1.0 + tolerance))

    def _vectors(self, action: Float[Array, "K"]) -> Float[Array, "N D"]:
        return action.reshape(self.num_agents, self.num_dims)


def _length(vectors: Float[Array, "N D"]) -> Float[Array, "N 1"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=1, keepdims=True))


def _largest(vectors: Float[Array, "N D"]) -> Float[Array, "N 1"]:
    return jnp.max(jnp.abs(vectors), axis=1, keepdims=True)


def _ratio(above: Float[Array, "N 1"], below: Float[Array, "N 1"]) -> Float[Array, "N 1"]:
    """The ratio; 0 at the centre, where both are 0."""
    return jnp.where(below > 0.0, above / jnp.where(below > 0.0, below, 1.0), 0.0)
