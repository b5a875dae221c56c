"""Images of robots, rendered by MuJoCo without a screen, through EGL or OSMesa; needs no JAX."""

import functools
import importlib
import os
import subprocess
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.errors import UserError

CAMERAS = "side", "overview"
"""Names of cameras in order of preference; without them, MuJoCo's free camera shows the whole model."""

BACKENDS = ("egl", "osmesa") if sys.platform == "linux" else ("",)
"""Values of `MUJOCO_GL` that are tried; on other systems MuJoCo's default needs no screen."""

_PROBE = (
    "import mujoco; model = mujoco.MjModel.from_xml_string('<mujoco/>'); "
    "renderer = mujoco.Renderer(model, 8, 8); renderer.render(); renderer.close()"
)
_PATIENCE = 60.0


class CannotDraw(UserError):
    """Robots cannot be rendered on this machine; the message says why."""


def backend() -> str:
    """The value of `MUJOCO_GL` that works on this machine, or `CannotDraw`; empty for MuJoCo's default.

    A value set by the user is the only one tried. Each value is tried in a separate process, since OpenGL can
    be bound only once in a process and a broken driver may end the process.
    """
    return _working(os.environ.get("MUJOCO_GL", "").strip().lower())


@functools.cache
def _working(asked: str) -> str:
    tried = (asked,) if asked else BACKENDS
    for name in tried:
        if _works(name):
            return name
    if asked:
        raise CannotDraw(f"MUJOCO_GL={asked} draws nothing here: unset it, and EGL and OSMesa are tried")
    raise CannotDraw(
        "robots cannot be drawn: neither EGL nor OSMesa works here; on Debian and Ubuntu: "
        "apt install libegl1 libgl1 (with a GPU's driver or libegl-mesa0), or libosmesa6"
    )


def _works(name: str) -> bool:
    environment = os.environ | ({"MUJOCO_GL": name} if name else {})
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=_PATIENCE
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0


class Renderer:
    """Renders a `RobotModel` in images of this size in pixels; has to be closed.

    Raises:
        CannotDraw: Nothing on this machine can render.
        ValueError: MuJoCo refuses the model.
    """

    def __init__(self, model: Any, width: int, height: int):
        mujoco = _mujoco()
        spec = model.spec()
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        if all(texture.type != mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
            white = {"rgb1": [1.0, 1.0, 1.0], "rgb2": [1.0, 1.0, 1.0], "width": 8, "height": 8}
            sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
            spec.add_texture(name="bojax_sky", type=sky, builtin=flat, **white)  # the default sky is black
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._forward = functools.partial(mujoco.mj_forward, self._model, self._data)
        names = [self._model.camera(index).name for index in range(self._model.ncam)]
        self._camera = next((name for name in CAMERAS if name in names), -1)
        self._renderer = mujoco.Renderer(self._model, height, width)

    def image(self, frame: NDArray[np.float64]) -> NDArray[np.uint8]:
        """An image `[height, width, 3]` for generalised positions, followed by poses of mocap bodies, if any.

        Raises:
            ValueError: The frame has another length than the model needs.
        """
        num, moved = self._model.nq, self._data.mocap_pos
        if len(frame) not in (num, num + moved.size):
            raise ValueError(f"the model has {num} generalised positions, a frame {len(frame)} numbers")
        self._data.qpos[:] = frame[:num]
        if len(frame) > num:
            moved[:] = frame[num:].reshape(moved.shape)
        self._forward()
        self._renderer.update_scene(self._data, self._camera)
        return self._renderer.render()

    def close(self) -> None:
        """Release the rendering context."""
        self._renderer.close()


def _mujoco() -> Any:
    """The module `mujoco`, imported after `MUJOCO_GL` is set, which MuJoCo reads when it is imported."""
    name, was_there = backend(), "mujoco" in sys.modules
    if name and os.environ.get("MUJOCO_GL") != name:
        os.environ["MUJOCO_GL"] = name
        if was_there:
            importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))
    from bojax.robots.models import mujoco

    return mujoco
