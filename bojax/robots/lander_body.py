"""Shape and weight of the lander and of its moon: the constants of Gym's LunarLander, without JAX.

Lengths are in Gym's units, of 30 pixels of its window: read as metres, they and the time step of 1/50 s give
the gravity of 10 m/s^2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PIXEL = 1.0 / 30.0
"""In metres."""

TIME_STEP = 0.02
"""In seconds."""

WIDTH, HEIGHT = 600.0 * PIXEL, 400.0 * PIXEL
"""Of the world that Gym shows, in metres."""

NUM_HEIGHTS = 11
"""Heights of the terrain are known at as many places, at equal distances; straight lines join them."""

PAD = (4, 5, 6)
"""The places between which the landing pad lies: it is flat, and its centre is the middle of the world."""

PAD_HEIGHT = 0.99 * HEIGHT / 4.0
"""Where the pad lies, in metres; Gym's mean over three neighbours has weights of 0.33."""

HULL = np.array([(-14, 17), (-17, 0), (-17, -10), (17, -10), (17, 0), (14, 17)]) * PIXEL
"""Corners of the hull around its origin, in metres."""

LEG = np.array([(-2, -8), (2, -8), (2, 8), (-2, 8)]) * PIXEL
"""Corners of a leg around its centre, in metres."""

LEG_CENTRE = np.array([20.0, -18.0]) * PIXEL
"""Centre of the right leg, in metres from the hull's origin, in which it hinges; the left one mirrors it."""

LEG_FOLDED = -0.05
"""Angle of the right leg to the hull where its joint is at 0, in radians."""

LEG_REST, LEG_STOP = 0.4, 0.9
"""Angles of the joint between which a leg moves outwards, in radians; its motor drives it to the first."""

MAIN_ENGINE = 4.0 * PIXEL
"""How far the main engine is below the hull's origin, in metres."""

SIDE_ENGINE = (12.0 * PIXEL, 17.0 * PIXEL, 14.0 * PIXEL)
"""How far a side engine is beside the hull's origin and, by sine and by cosine of the tilt, above it."""

ORIGIN = (0.5 * WIDTH, 0.25 * HEIGHT + 18.0 * PIXEL)
"""Where an observation has (0, 0), in metres: there the hull's origin is on the pad, but for 1 cm."""

UNITS = (0.5 * WIDTH, 0.5 * HEIGHT)
"""What an observation calls 1, to the side and up, in metres."""


class Mass(NamedTuple):
    """A rigid body in a plane.

    Attributes:
        mass: In kg.
        centre: Of the mass, in metres.
        inertia: About it, in kg m^2.
    """

    mass: float
    centre: NDArray[np.float64]
    inertia: float


def polygon(corners: NDArray[np.float64], density: float) -> Mass:
    """A polygon of one density, in kg/m^2: sums over the triangles between its edges and the origin."""
    after = np.roll(corners, -1, axis=0)
    doubled = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    mass = 0.5 * density * float(doubled.sum())
    centre = density * (doubled @ (corners + after)) / (6.0 * mass)
    squares = np.sum(corners**2 + corners * after + after**2, axis=1)
    inertia = density * float(doubled @ squares) / 12.0
    return Mass(mass, centre, inertia - mass * float(centre @ centre))


def rotated(vectors: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Vectors turned anticlockwise, `[..., 2]`."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cosine, sine], [-sine, cosine]])


def joined(parts: list[Mass]) -> Mass:
    """Several bodies as one."""
    mass = sum(part.mass for part in parts)
    centre = np.sum([part.mass * part.centre for part in parts], axis=0) / mass
    inertia = sum(part.inertia + part.mass * float(np.sum((part.centre - centre) ** 2)) for part in parts)
    return Mass(mass, centre, inertia)


def lander(leg_angle: float) -> Mass:
    """Hull and legs, with both joints held at an angle in radians; the centre is from the hull's origin."""
    leg = polygon(LEG, density=1.0)
    right = rotated(LEG_CENTRE, leg_angle + LEG_FOLDED)
    sides = [leg._replace(centre=right * mirror) for mirror in (np.array([1.0, 1.0]), np.array([-1.0, 1.0]))]
    return joined([hull(), *sides])


def hull() -> Mass:
    """The hull alone."""
    return polygon(HULL, density=5.0)
