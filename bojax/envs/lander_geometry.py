"""Geometry and mass of the lander and its terrain: the constants of Gym's LunarLander, without JAX.

Gym's unit of length is 30 pixels of its window. Read as metres, and with a time step of 1/50 s, the constants
give a gravity of 10 m/s^2.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

PIXEL = 1.0 / 30.0  # length of a pixel of Gym's window, in metres
TIME_STEP = 0.02  # duration of a simulation step, in seconds
WIDTH, HEIGHT = 600.0 * PIXEL, 400.0 * PIXEL  # size of the region that Gym's window shows, in metres
NUM_HEIGHTS = 11  # number of terrain vertices, equally spaced over the width and joined by straight lines
PAD = (4, 5, 6)  # indices of the terrain vertices of the landing pad, which is flat and centred

PAD_HEIGHT = 0.99 * HEIGHT / 4.0
"""Height of the pad in metres; the weights of Gym's three-point average sum to 0.99."""

HULL = np.array([(-14, 17), (-17, 0), (-17, -10), (17, -10), (17, 0), (14, 17)]) * PIXEL
"""Corners of the hull relative to its origin, in metres."""

LEG = np.array([(-2, -8), (2, -8), (2, 8), (-2, 8)]) * PIXEL
"""Corners of a leg relative to its centre, in metres."""

LEG_CENTRE = np.array([20.0, -18.0]) * PIXEL
"""Centre of the right leg relative to its hinge, the hull's origin, in metres; the left leg mirrors it."""

LEG_FOLDED = -0.05  # angle of the right leg relative to the hull at joint angle 0, in radians

LEG_REST, LEG_STOP = 0.4, 0.9
"""Limits of the outward joint angle of a leg, in radians; the joint's motor drives it to the lower one."""

MAIN_ENGINE = 4.0 * PIXEL  # distance of the main engine below the hull's origin, in metres

SIDE_ENGINE = (12.0 * PIXEL, 17.0 * PIXEL, 14.0 * PIXEL)
"""Offset of a side engine from the hull's origin, in metres: sideways, and above it in x and in y."""

ORIGIN = (0.5 * WIDTH, 0.25 * HEIGHT + 18.0 * PIXEL)
"""Position of the hull's origin observed as (0, 0), in metres; 1 cm off a lander on the pad."""

UNITS = (0.5 * WIDTH, 0.5 * HEIGHT)
"""Horizontal and vertical distance that an observation reads as 1, in metres."""


class Mass(NamedTuple):
    """Mass properties of a rigid body in the plane."""

    mass: float  # mass in kg
    centre: Float[np.ndarray, "2"]  # centre of mass, in metres
    inertia: float  # moment of inertia about the centre of mass, in kg m^2


def polygon(corners: Float[np.ndarray, "N 2"], density: float) -> Mass:
    """Mass properties of a polygon of uniform density in kg/m^2: sums over its triangles with the origin."""
    after = np.roll(corners, -1, axis=0)
    doubled = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    mass = 0.5 * density * float(doubled.sum())
    centre = density * (doubled @ (corners + after)) / (6.0 * mass)
    squares = np.sum(corners**2 + corners * after + after**2, axis=1)
    inertia = density * float(doubled @ squares) / 12.0
    return Mass(mass, centre, inertia - mass * float(centre @ centre))


def rotated(vectors: Float[np.ndarray, "... 2"], angle: float) -> Float[np.ndarray, "... 2"]:
    """Vectors `[..., 2]` rotated anticlockwise by an angle in radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cosine, sine], [-sine, cosine]])


def combined(parts: list[Mass]) -> Mass:
    """Mass properties of several bodies joined rigidly."""
    mass = sum(part.mass for part in parts)
    centre = np.sum([part.mass * part.centre for part in parts], axis=0) / mass
    inertia = sum(part.inertia + part.mass * float(np.sum((part.centre - centre) ** 2)) for part in parts)
    return Mass(mass, centre, inertia)


def lander(leg_angle: float) -> Mass:
    """Mass properties of hull and legs about the hull's origin, with both joints at an angle in radians."""
    leg = polygon(LEG, density=1.0)
    right = rotated(LEG_CENTRE, leg_angle + LEG_FOLDED)
    sides = [leg._replace(centre=right * mirror) for mirror in (np.array([1.0, 1.0]), np.array([-1.0, 1.0]))]
    return combined([hull(), *sides])


def hull() -> Mass:
    """Mass properties of the hull."""
    return polygon(HULL, density=5.0)
