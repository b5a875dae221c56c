"""Paths in the robot's frame, and the families of trajectories that planners choose from."""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

Path = Float[Array, "S 3"]
"""Poses (x and y in metres, heading in radians) at equal arc lengths, excluding the start."""

Pose = Float[Array, "3"]
"""x and y in metres, heading in radians."""


KNOTS = 65  # number of points at which the speed along a curve is computed, to measure its length


class Poses:
    """The poses of a path, or one pose, as columns: for kernels, which cannot slice an array.

    They are indexed like an array [..., 3], but only by `path[..., i]`, by `path[-1]`, which is one pose, and
    by `pose[i]`.

    Args:
        columns: The columns x, y and heading.
        last: The last pose of a path; None for one pose.
    """

    def __init__(self, columns: Sequence[Float[Array, "*S"]], last: "Poses | None" = None):
        self._columns, self._last = columns, last

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return *self._columns[0].shape, 3

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple) and len(index) == 2 and index[0] is ...:
            return self._columns[index[1]]
        if not isinstance(index, tuple):
            if self._last is None:
                return self._columns[index]
            if index == -1:
                return self._last
        raise IndexError(f"got poses[{index}]; allowed in a kernel: poses[..., i] and poses[-1]")


@eqx.filter_jit  # traced and lowered once where a program drives several times
def place(path: Float[Array, "*S 3"], pose: Pose) -> Float[Array, "*S 3"]:
    """A path in the frame of a robot at `pose`, transformed to the world frame; headings are not wrapped."""
    return jnp.stack(placed(path, pose), axis=-1)


def placed(path: Float[Array, "*S 3"] | Poses, pose: Pose | Poses) -> list[Float[Array, "*S"]]:
    """The columns of `place`."""
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    x, y = path[..., 0], path[..., 1]
    return [pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y, pose[2] + path[..., 2]]


def sample_by_arc_length(
    curve: Callable[[Float[Array, ""]], Float[Array, "2"]], length: Float[Array, ""], num_samples: int
) -> Path:
    """A plane curve over [0, 1], scaled to `length` and sampled at equal arc lengths.

    Section 4.7.2 requires constant velocity and constant length of every trajectory. Arc length is computed
    by the trapezoidal rule; positions and headings are exact at the parameters found.

    Args:
        curve: Differentiable position on [0, 1], starting at the origin.
        length: Arc length of the result, in metres.
        num_samples: Number S of poses, at the arc lengths length/S, 2 length/S, ..., length.
    """

    def position_and_velocity(u):
        return jax.jvp(curve, (u,), (jnp.ones_like(u),))

    # Arc length as a table over the parameter, inverted by interpolation at equal lengths.
    knots = jnp.linspace(0.0, 1.0, KNOTS, dtype=length.dtype)
    _, velocity = jax.vmap(position_and_velocity)(knots)
    # Elementwise arithmetic: on a CPU, a sum over two coordinates takes longer than all the velocities.
    speed = jnp.sqrt(velocity[:, 0] ** 2 + velocity[:, 1] ** 2)
    pieces = 0.5 * (speed[1:] + speed[:-1]) / (KNOTS - 1)
    arc = jnp.concatenate([jnp.zeros((1,), length.dtype), jnp.cumsum(pieces)])
    targets = arc[-1] * jnp.arange(1, num_samples + 1, dtype=length.dtype) / num_samples
    position, velocity = jax.vmap(position_and_velocity)(jnp.interp(targets, arc, knots))
    heading = jnp.arctan2(velocity[:, 1], velocity[:, 0])
    return jnp.concatenate([position * (length / arc[-1]), heading[:, None]], axis=-1)


class ContinuousMotions(eqx.Module):
    """A family of trajectories with parameters in the box [-1, 1]^D."""

    length: eqx.AbstractVar[Float[Array, ""]]
    num_samples: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def num_params(self) -> int:
        """Dimension D of the parameters."""

    @abc.abstractmethod
    def path(self, params: Float[Array, "D"]) -> Path:
        """The path of one parameter vector."""

    def draw(self, key: Key[Array, ""]) -> Float[Array, "D"]:
        """A parameter vector drawn uniformly from the box."""
        shape = (self.num_params,)
        return jax.random.uniform(key, shape, self.length.dtype, minval=-1.0, maxval=1.0)

    def sample(self, key: Key[Array, ""]) -> Path:
        """The path of a parameter vector drawn uniformly from the box."""
        return self.path(self.draw(key))


class DiscreteMotions(eqx.Module):
    """A finite set of trajectories."""

    length: eqx.AbstractVar[Float[Array, ""]]
    num_samples: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def num_actions(self) -> int:
        """Number A of paths."""

    @property
    def count(self) -> Int[Array, ""]:
        """Number of trajectories of the set, the first paths; further ones only fill up its room."""
        return jnp.asarray(self.num_actions, jnp.int32)

    def with_room(self) -> "DiscreteMotions":
        """The same set with room for the largest of its kind, so that sets of all sizes share a program."""
        return self

    @abc.abstractmethod
    def paths(self) -> Float[Array, "A S 3"]:
        """All paths."""

    def sample(self, key: Key[Array, ""]) -> Path:
        """One of the paths, each with the same probability."""
        index: Int[Array, ""] = jax.random.randint(key, (), 0, self.num_actions)
        return self.paths()[index]


Motions = ContinuousMotions | DiscreteMotions


DENSE = 400
"""Number of poses of a path for computing its curvature; more change no family's radius by half a percent."""


@jax.jit
def _all_paths(motions: DiscreteMotions) -> Float[Array, "A S 3"]:
    return motions.paths()


@jax.jit
def _paths_of(motions: ContinuousMotions, params: Float[Array, "N P"]) -> Float[Array, "N S 3"]:
    return jax.vmap(motions.path)(params)


def tightest_radius(motions: Motions) -> float:
    """Radius in metres of the tightest curve in a family, computed on the host before anything runs.

    Curvature is the change of heading per arc length between `DENSE` poses of a path, so that the radius does
    not depend on `num_samples`. A family that ignores `num_samples` is judged by the poses that its paths
    have. Of a continuous family, the corners of the box, the midpoints of its edges and faces, and its centre
    are evaluated.
    """
    if any(field.name == "num_samples" and field.init for field in dataclasses.fields(motions)):
        motions = dataclasses.replace(motions, num_samples=max(motions.num_samples, DENSE))
    if isinstance(motions, DiscreteMotions):
        paths = _all_paths(motions)[: int(motions.count)]
    else:
        levels = np.meshgrid(*[[-1.0, 0.0, 1.0]] * motions.num_params)
        params = jnp.asarray(np.stack(levels, axis=-1).reshape(-1, motions.num_params), motions.length.dtype)
        paths = _paths_of(motions, params)
    headings = np.unwrap(np.asarray(paths)[..., 2], axis=-1)
    step = float(motions.length) / headings.shape[-1]
    headings = np.concatenate([np.zeros_like(headings[:, :1]), headings], axis=-1)
    turn = np.abs(np.diff(headings, axis=-1)).max()
    return float("inf") if turn == 0.0 else step / float(turn)
