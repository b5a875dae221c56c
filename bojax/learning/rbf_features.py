"""Normalised radial basis functions of states and actions: local features that do not extrapolate."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.config.limits import FEATURES
from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Discrete, Space
from bojax.learning.features import FeatureSpec, ProductFeatures
from bojax.numerics.quasirandom import scrambled_halton


class RBFFeatures(ProductFeatures):
    """Products of normalised radial basis functions of the state and of the action.

    x_i(s) = g_i(s) / |g(s)| with g_i(s) = exp(-|s - c_i|^2 / (2 w^2)), and y(a) likewise. Bounds are mapped
    to [0, 1], and values outside are clipped. phi is the outer product of x and y, of norm 1. Far from all
    centres, the function of the nearest one has the whole weight (normalised radial basis functions: Moody
    and Darken, Neural Computation 1, 1989, with a Euclidean norm in place of their sum).
    """

    observations: Space  # bounds of observations
    actions: Space  # space of actions
    state_centres: Float[Array, "P D"]  # centres in the observations, in [0, 1]
    action_centres: Float[Array, "R A"]  # centres in the actions, in [0, 1]
    state_width: Float[Array, ""]  # width of the functions of the state (w)
    action_width: Float[Array, ""]  # width of those of the action

    @property
    @override
    def num_features(self) -> int:
        return len(self.state_centres) * len(self.action_centres)

    @override
    def state(self, observation: Observation) -> Float[Array, "P"]:
        return _normalised(self.observations.to_unit(observation), self.state_centres, self.state_width)

    @override
    def action(self, action: Action) -> Float[Array, "R"]:
        if isinstance(self.actions, Discrete):
            return jax.nn.one_hot(action, self.actions.num, dtype=self.action_centres.dtype)
        return _normalised(self.actions.to_unit(action), self.action_centres, self.action_width)


class NormalisedRBFSpec(FeatureSpec):
    """Normalised radial basis functions around the points of scrambled Halton sequences.

    A width of 1 is the mean distance of neighbouring centres, N^(-1/D) for N centres in D dimensions.

    Settings: `bojax.learning.settings.NormalisedRBF`.
    """

    num_state_centres: int = eqx.field(static=True)
    num_action_centres: int = eqx.field(static=True)
    width: Float[Array, ""]

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        FEATURES.check(self.count(observation_space, action_space), "learner.features")

    @override
    def count(self, observation_space: Space, action_space: Space) -> int:
        is_discrete = isinstance(action_space, Discrete)
        return self.num_state_centres * (action_space.num if is_discrete else self.num_action_centres)

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> RBFFeatures:
        key_state, key_action = jax.random.split(key)
        num_actions = self.count(observation_space, action_space) // self.num_state_centres
        spaces = (
            (key_state, self.num_state_centres, observation_space.num_dims),
            (key_action, num_actions, action_space.num_dims),
        )
        centres = [scrambled_halton(key, number, dims, dtype) for key, number, dims in spaces]
        widths = [self.width.astype(dtype) * number ** (-1.0 / dims) for _, number, dims in spaces]
        return RBFFeatures(observation_space, action_space, *centres, *widths)


def _normalised(
    unit: Float[Array, "D"], centres: Float[Array, "N D"], width: Float[Array, ""]
) -> Float[Array, "N"]:
    """The functions around all centres, divided by their Euclidean norm."""
    point = jnp.clip(unit, 0.0, 1.0).astype(centres.dtype)
    squares = jnp.sum((point[None, :] - centres) ** 2, axis=1)
    # Relative to the nearest centre: far from all of them, every function alone would underflow to 0.
    functions = jnp.exp(-0.5 * (squares - jnp.min(squares)) / width**2)
    return functions / jnp.linalg.norm(functions)
