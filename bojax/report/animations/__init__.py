"""Animations of recorded runs, drawn from the files of a results folder; each environment has a scene."""

from collections.abc import Mapping

from bojax.report.animations.base import Scene
from bojax.report.animations.cartpole_swing_up import CartpoleSwingUp
from bojax.report.animations.double_pendulum import DoublePendulum
from bojax.report.animations.lunar_lander import LunarLander
from bojax.report.animations.mountain_car import MountainCar
from bojax.report.animations.single_pendulum import SinglePendulum

SCENES: Mapping[str, type[Scene]] = {
    "single-pendulum": SinglePendulum,
    "mountain-car": MountainCar,
    "double-pendulum": DoublePendulum,
    "cartpole-swing-up": CartpoleSwingUp,
    "lunar-lander": LunarLander,
}
"""The scene of every environment that can be drawn, by identifier."""
