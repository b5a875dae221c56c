"""Features that need no settings: their number and lengthscales follow from the spaces of an environment."""

import jax.numpy as jnp
from jaxtyping import Array, Key
from typing_extensions import override

from bojax.envs.spaces import Discrete, Space
from bojax.learning.features import FeatureSpec, OneHotSpec, RandomFourierSpec, StateActionFeatures
from bojax.learning.settings import OneHot, RandomFourierFeatures

MOST_PAIRS = 1000
"""Largest number of pairs of a discrete state and a discrete action with a feature each."""


class AutoSpec(FeatureSpec):
    """Features chosen by a rule for the spaces of an environment, see `chosen`.

    Settings: `bojax.learning.settings.AutoFeatures`.
    """

    @override
    def fitted(self, observation_space: Space, action_space: Space, dtype: jnp.dtype) -> FeatureSpec:
        settings = chosen(observation_space, action_space)
        if isinstance(settings, OneHot):
            return _ChosenOneHot()
        return _ChosenFourier(
            jnp.asarray(settings.state_lengthscale, dtype),
            jnp.asarray(settings.action_lengthscale, dtype),
            settings.num_features,
            settings.kernel,
            settings.sampling,
            settings.form,
        )

    @override
    def draw(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, dtype: jnp.dtype
    ) -> StateActionFeatures:
        fitted = self.fitted(observation_space, action_space, dtype)
        return fitted.draw(key, observation_space, action_space, dtype)


def chosen(observation_space: Space, action_space: Space) -> RandomFourierFeatures | OneHot:
    """The settings of the features for two spaces; bounds are mapped to [0, 1] before any feature.

    Up to `MOST_PAIRS` pairs of a discrete state and a discrete action have a feature each. All other spaces
    have random Fourier features. Their number is that of Table 5.2 of the thesis: 300 for at most 4
    dimensions of state and action, 500 for more. The state lengthscale is 0.3 for one or two dimensions, as
    in the thesis, and grows with their square root, as distances in a cube do (Hvarfner et al., 2024). The
    action lengthscale is 3 for a box, which docs/features-without-settings.md measures, and 0.3 for discrete
    actions, whose numbers have no order.
    """
    is_discrete = isinstance(action_space, Discrete)
    if isinstance(observation_space, Discrete) and isinstance(action_space, Discrete):
        if observation_space.num * action_space.num <= MOST_PAIRS:
            return OneHot()
    num_dims = observation_space.num_dims
    return RandomFourierFeatures(
        num_features=300 if num_dims + action_space.num_dims <= 4 else 500,
        state_lengthscale=round(0.3 * max(1.0, num_dims / 2) ** 0.5, 2),
        action_lengthscale=0.3 if is_discrete else 3.0,
    )


class _ChosenFourier(RandomFourierSpec):
    @property
    def resolved_settings(self) -> dict[str, object]:
        """The settings that `auto` stands for."""
        return RandomFourierFeatures(
            num_features=self.num_features,
            state_lengthscale=round(float(self.state_lengthscale), 2),
            action_lengthscale=round(float(self.action_lengthscale), 2),
        ).model_dump()


class _ChosenOneHot(OneHotSpec):
    @property
    def resolved_settings(self) -> dict[str, object]:
        """The settings that `auto` stands for."""
        return OneHot().model_dump()
