"""Models of robots: MJCF text, compiled by MuJoCo. JAX is not needed here, so that reports can draw them."""

import functools
import importlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

from bojax.config.extras import MissingExtra

try:
    mujoco: Any = importlib.import_module("mujoco")  # it has no types
except ImportError as error:
    raise MissingExtra("mujoco", "robots") from error

MjModel: TypeAlias = Any
"""A model as C MuJoCo computes with it."""


@dataclass(frozen=True)
class RobotModel:
    """A robot and the world around it, as text; two of the same text are the same.

    Attributes:
        xml: The MJCF.
        path: The file that it was read from; what it includes, and meshes, are looked for beside it.
    """

    xml: str
    path: str | None = None

    def spec(self) -> Any:
        """The model as it can be edited.

        Raises:
            ValueError: It is no MJCF.
        """
        try:
            if self.path is None:
                return mujoco.MjSpec.from_string(self.xml)
            return mujoco.MjSpec.from_file(self.path)
        except ValueError as error:
            raise ValueError(_one_line(error)) from error

    def compiled(self) -> MjModel:
        """The model as MuJoCo computes with it; the same object every time.

        Raises:
            ValueError: MuJoCo refuses it.
        """
        return _compiled(self)


def packaged(name: str) -> RobotModel:
    """A model that comes with bojax, such as `hopper`."""
    return RobotModel(resources.files("bojax.robots").joinpath("mjcf", f"{name}.xml").read_text("utf-8"))


def from_file(path: str | Path) -> RobotModel:
    """A model of one's own.

    Raises:
        ValueError: The file cannot be read.
    """
    path = Path(path)
    try:
        return RobotModel(path.read_text("utf-8"), str(path.resolve()))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {_one_line(error)}") from error


@functools.cache
def _compiled(model: RobotModel) -> MjModel:
    try:
        return model.spec().compile()
    except ValueError as error:
        raise ValueError(_one_line(error)) from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
