"""The families of motions under test: every built-in one, and some with other settings; their paths."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.motions.base import DiscreteMotions, Motions
from bojax.motions.kernel_trajectories import KernelTrajectories
from bojax.motions.splines import CubicCurves, SplineSet

NUM_SAMPLES = 8
FINE = 250
"""Samples of a fine path for each sample of a coarse one."""


def numbers(**values: float) -> dict[str, jax.Array]:
    """Strongly typed scalars."""
    return {name: jnp.asarray(value, jnp.float64) for name, value in values.items()}


def splines(actions: int, length: float = 1.0) -> SplineSet:
    return SplineSet(**numbers(length=length), actions=actions, num_samples=NUM_SAMPLES)


def cubic(length: float = 1.0) -> CubicCurves:
    return CubicCurves(**numbers(length=length, bearing=0.8, heading=1.5), num_samples=NUM_SAMPLES)


def kernel(start="pose", num_segments: int = 3, **changes: float) -> KernelTrajectories:
    values = numbers(
        length=1.0,
        first_angle=0.3,
        turn_angle=1.0,
        space_lengthscale=0.5,
        time_lengthscale=0.7,
        epsilon=0.1,
        delta=1e-5,
    )
    return KernelTrajectories(
        **(values | numbers(**changes)), num_segments=num_segments, start=start, num_samples=NUM_SAMPLES
    )


FAMILIES: dict[str, Motions] = {
    kind: build(schema.model_validate({"num_samples": NUM_SAMPLES}))
    for kind, schema in kinds("motions").items()
} | {
    "splines-17": splines(17, length=1.7),
    "kernel-other": kernel(),
    "kernel-4-segments": kernel(num_segments=4, length=0.6, first_angle=0.3, turn_angle=0.7),
    "kernel-relaxed": kernel(start="relaxed"),
}


def resampled(motions: Motions, num_samples: int) -> Motions:
    """The same family, seen at other arc lengths."""
    return dataclasses.replace(motions, num_samples=num_samples)


def grid(motions: Motions, levels: int | None = None) -> jax.Array:
    """A grid over the box of parameters, its corners and its centre included."""
    levels = levels or {1: 9, 2: 7, 3: 5}.get(motions.num_params, 3)
    axis = np.linspace(-1.0, 1.0, levels)
    return jnp.asarray(list(itertools.product(*[axis] * motions.num_params)))


@jax.jit
def paths_of(motions: Motions, params: jax.Array) -> jax.Array:
    """The path of each row of parameters."""
    return jax.vmap(motions.path)(params)


set_of = jax.jit(lambda motions: motions.paths())


def all_paths(motions: Motions, num_samples: int = NUM_SAMPLES) -> np.ndarray:
    """Paths of the whole family: every action, or a grid of parameters."""
    motions = resampled(motions, num_samples)
    if isinstance(motions, DiscreteMotions):
        return np.asarray(set_of(motions))
    return np.asarray(paths_of(motions, grid(motions)))


@functools.cache
def fine_paths(name: str) -> np.ndarray:
    """All paths of a family of `FAMILIES`, finely sampled."""
    return all_paths(FAMILIES[name], FINE * NUM_SAMPLES)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """An angle as a turn to the left or to the right, in [-pi, pi)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi
