"""The model of every robot that can be watched, from the settings in a manifest. JAX is not needed."""

from collections.abc import Callable, Mapping
from typing import Any

from bojax.robots import car, quadrotor
from bojax.robots.jaco import jaco_model
from bojax.robots.models import RobotModel, packaged

Settings = Mapping[str, Any]

ENVS: Mapping[str, Callable[[Settings], RobotModel]] = {
    "hopper": lambda env: packaged("hopper"),
    "reacher": lambda env: packaged("reacher"),
    "jaco": lambda env: jaco_model(env["joints"]),
}
"""By the kind of an environment, from its settings."""

VEHICLES: Mapping[str, Callable[[Settings], RobotModel]] = {
    "wheeled-robot": car.scene_of,
    "quadrotor": quadrotor.scene_of,
}
"""By the kind of a vehicle, from the settings of the problem whose vehicle it is."""
