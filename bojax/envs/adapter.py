"""Observations and actions as the users of an environment have them, and as learners of bojax do."""

from typing import Any

import numpy as np

from bojax.envs.spaces import Box, Discrete, Space
from bojax.numerics.trial import Misfit


class Adapter:
    """Converts between an environment's own values and vectors or integers from 0, one at a time.

    The environments of bojax have these values themselves; one of another library overrides the methods.
    """

    def __init__(self, observations: Space, actions: Space):
        self.observations, self.actions = observations, actions

    def observation(self, value: Any) -> Any:
        """The vector, or the integer from 0, of an observation of the environment.

        Raises:
            Misfit: The observation does not fit its space.
        """
        try:
            found = np.asarray(value)
        except ValueError as error:  # nested lists of unequal lengths
            raise Misfit("the observation is no array") from error
        space = self.observations
        if found.dtype.kind not in ("iu" if isinstance(space, Discrete) else "biuf"):
            kind = "integers" if isinstance(space, Discrete) else "numbers"
            raise Misfit(f"the observation has dtype {found.dtype}; allowed: {kind}")
        if isinstance(space, Box):
            if found.size != space.num_dims:
                allowed = f"{space.num_dims} numbers"
                raise Misfit(f"the observation has shape {found.shape}; allowed: {allowed}")
            return found.ravel()
        if found.shape or not 0 <= found < space.num:
            raise Misfit(f"the observation is {found}; allowed: an integer from 0 to {space.num - 1}")
        return int(found)

    def action(self, value: np.ndarray) -> Any:
        """The action that the environment takes."""
        return value[()]  # an integer in place of an array without axes
