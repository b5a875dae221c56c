"""Robot models: MJCF text compiled by MuJoCo, without JAX, so that reports can draw them."""

import functools
import importlib
from collections.abc import Collection
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from bojax.config.limits import TEXT, read_within
from bojax.text import one_line

mujoco: Any = importlib.import_module("mujoco")  # MuJoCo has no type stubs

MjModel: TypeAlias = Any
"""A compiled model of C MuJoCo."""


@dataclass(frozen=True)
class RobotModel:
    """An MJCF model of a robot and its world, compared and hashed by its text."""

    xml: str  # the MJCF
    # File that the MJCF was read from; included files and meshes are resolved relative to it
    path: str | None = None

    def spec(self) -> Any:
        """The editable specification of the model.

        Raises:
            ValueError: The text is not valid MJCF.
        """
        try:
            if self.path is None:
                return mujoco.MjSpec.from_string(self.xml)
            return mujoco.MjSpec.from_file(self.path)
        except ValueError as error:
            name = "" if self.path is None else f"{Path(self.path).name}: "
            raise ValueError(f"{name}{one_line(error)}") from error

    def compiled(self) -> MjModel:
        """The compiled model, cached.

        Raises:
            ValueError: MuJoCo refuses the model.
        """
        return _compiled(self)


def packaged(name: str) -> RobotModel:
    """A model shipped with bojax, such as `hopper`."""
    return RobotModel(resources.files("bojax.robots").joinpath("mjcf", f"{name}.xml").read_text("utf-8"))


def from_file(path: str | Path) -> RobotModel:
    """A model from an MJCF file.

    Raises:
        ValueError: The file cannot be read.
    """
    path = Path(path)
    try:
        return RobotModel(read_within(TEXT, path, str(path)).decode(), str(path.resolve()))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise ValueError(f"{path}: {reason or one_line(error)}") from error


def serialised(model: MjModel) -> bytes:
    """A compiled model as MuJoCo saves it: everything that it was made of, meshes and included files too."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


@functools.cache
def _compiled(model: RobotModel) -> MjModel:
    try:
        return model.spec().compile()
    except ValueError as error:
        raise ValueError(one_line(error)) from error


def jaco_model(joints: Collection[int]) -> RobotModel:
    """The Jaco arm with only these joints movable (thesis, Section 5.7.3).

    Joints are numbered from 1 at the base to 6 at the hand. The others are fixed in the upright
    configuration of the arm and have no motor.
    """
    spec = packaged("jaco").spec()
    for number in range(1, 7):
        if number not in joints:
            for part in (spec.actuator(f"joint_{number}"), spec.joint(f"joint_{number}")):
                spec.delete(part)
    return RobotModel(spec.to_xml())
