"""Parts given by import path: import the user's class, and make a schema class from what it says it takes.

After that an external part is a component like any other. The class says what it takes by a nested
pydantic `Config`, or else by the annotations of its constructor.
"""

import dataclasses
import importlib
import inspect
import sys
import traceback
import types
import typing
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Literal, Union, get_args, get_origin

import pydantic
from pydantic.fields import FieldInfo

from bojax.config.component import Component, External
from bojax.config.errors import ConfigError, Location, did_you_mean, from_validation, shown
from bojax.config.sweep import Point, Sweep

Numbers = float | tuple["Numbers", ...]
"""A number, or a list of numbers, or a list of these."""


def resolve(sweep: Sweep) -> Sweep:
    """The sweep with every import path imported and its settings validated; runs the user's module.

    Raises:
        ConfigError: There is no such module or class, or it does not take these settings.
    """
    points = []
    for point in sweep.points:
        config = _resolve(point.config, (), lambda location, index=point.index: sweep.locate(index, location))
        variant = config.label if point.variant == point.config.label else point.variant
        points.append(Point(point.index, config.label, variant, point.swept, config))
    return dataclasses.replace(sweep, points=tuple(points))
