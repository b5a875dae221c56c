"""The model of every robot that can be watched, from the settings in a manifest. JAX is not needed."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.robots import car
from bojax.robots.jaco import jaco_model
from bojax.robots.models import RobotModel, packaged

Settings = Mapping[str, Any]

ENVS: Mapping[str, Callable[[Settings], RobotModel]] = {
    "hopper": lambda env: packaged("hopper"),
    "reacher": lambda env: packaged("reacher"),
    "jaco": lambda env: jaco_model(env["joints"]),
}
"""By the kind of an environment, from its settings."""

VEHICLES: Mapping[str, Callable[[Settings, NDArray[np.float64] | None], RobotModel]] = {
    "wheeled-robot": lambda problem, truth: car.scene_of(problem),
}
"""By the kind of a vehicle, from its problem's settings, and from the true field on a grid where it is known.

The first axis of the grid is y, from the lowest, the second x; it spans the problem's `domain`.
"""
