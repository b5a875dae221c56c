"""The model of the quadrotor, and the world that it flies over, to be drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.robots.models import RobotModel, mujoco, packaged
from bojax.robots.surroundings import domain_of, furnish

_BASE = 0.05
"""What lies below the lowest ground of a height field, in metres."""

_GROUND_POINTS = 81
"""Points a side of a height field."""

_OWN = [0.5, 0.5, 0.5, 1.0]
"""The colour that leaves that of a material as it is."""


def quadrotor_model() -> RobotModel:
    """The quadrotor alone, in an empty world."""
    return packaged("quadrotor")


def scene(
    domain: Sequence[float],
    blocks: NDArray[np.float64] | None = None,
    ground: NDArray[np.float64] | None = None,
) -> RobotModel:
    """The quadrotor above a floor with blocks, or above ground of these heights.

    It cannot touch them: they are there to be seen. A camera named `overview` sees all of the domain.

    Args:
        domain: `[x_min, y_min, x_max, y_max]` in metres.
        blocks: Rows of x_min, y_min, x_max, y_max and height, in metres.
        ground: Heights in metres on a grid over the domain, in place of a floor; the first axis is y, from
            the lowest, the second x.
    """
    spec = quadrotor_model().spec()
    low, high = np.asarray(domain[:2], float), np.asarray(domain[2:], float)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    reach = float(np.max(half))
    free = {"contype": 0, "conaffinity": 0}
    if ground is None:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            pos=[*middle, 0.0],
            size=[*half, 0.1],
            material="floor",
            rgba=_OWN,
            **free,
        )
    else:
        bottom, top = float(np.min(ground)), float(np.max(ground))
        rise = max(top - bottom, 1e-6)
        spec.add_hfield(
            name="ground",
            size=[*half, rise, _BASE],
            nrow=ground.shape[0],
            ncol=ground.shape[1],
            userdata=((ground - bottom) / rise).ravel().tolist(),
        )
        spec.worldbody.add_geom(
            name="ground",
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname="ground",
            pos=[*middle, bottom],
            material="ground",
            rgba=_OWN,
            **free,
        )
    for x_min, y_min, x_max, y_max, height in () if blocks is None else blocks:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.5 * height],
            size=[0.5 * (x_max - x_min), 0.5 * (y_max - y_min), 0.5 * height],
            material="prop",
            rgba=_OWN,
            **free,
        )
    spec.stat.extent = 2.0 * reach  # shadows are cast as far as this
    spec.worldbody.add_camera(
        name="overview",
        pos=[middle[0], middle[1] - 2.6 * reach, 2.4 * reach],
        xyaxes=[1.0, 0.0, 0.0, 0.0, 0.68, 0.73],
    )
    return RobotModel(spec.to_xml())


def scene_of(problem: Mapping[str, Any]) -> RobotModel:
    """The world of a problem, from its settings as the manifest of results has them.

    Blocks and bumps are drawn as they are, other fields and none as a floor; with walls, and the lot if it
    has to park.
    """
    field, domain = problem.get("field") or {}, domain_of(problem)
    blocks, ground, heights = None, None, np.zeros(1)
    if field.get("kind") == "blocks":
        heights = np.asarray(field["heights"])
        blocks = np.column_stack([field["boxes"], heights])
    elif field.get("kind") == "bumps":
        axes = (np.linspace(domain[low], domain[low + 2], _GROUND_POINTS) for low in (0, 1))
        points = np.stack(np.meshgrid(*axes), axis=-1)[:, :, None]
        squared = np.sum((points - np.asarray(field["centres"])) ** 2, axis=-1)
        ground = heights = np.exp(-0.5 * squared / np.square(field["widths"])) @ np.asarray(field["heights"])
    spec = scene(domain, blocks, ground).spec()
    furnish(spec, problem, min(0.0, float(heights.min())), float(heights.max()))
    return RobotModel(spec.to_xml())
