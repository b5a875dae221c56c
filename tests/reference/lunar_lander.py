"""Gymnasium's LunarLander, stepped by Box2D: started and disturbed as a test wants it."""

from collections.abc import Sequence

import gymnasium
import numpy as np


class Scripted:
    """In the place of Gymnasium's random numbers: those of a list, as shares of the range asked for."""

    def __init__(self, shares: Sequence[float]):
        self._shares = list(shares)

    def uniform(self, low, high, size=(1,)):
        shares, self._shares = self._shares[: size[0]], self._shares[size[0] :]
        drawn = low + (high - low) * np.array(shares)
        return drawn if len(drawn) > 1 else float(drawn[0])


class GymLander:
    """The continuous LunarLander-v3 without wind."""

    def __init__(self):
        self.env = gymnasium.make("LunarLander-v3", continuous=True).unwrapped

    def reset(self, heights=(0.5,) * 12, push=(0.5, 0.5)):
        """The first observation, with heights and force as shares of their ranges."""
        self.env.np_random = Scripted([*heights, *push, 0.5, 0.5])
        return self.env.reset()[0]

    def step(self, action, noise=(0.0, 0.0)):
        """One step whose engines are displaced by `noise`, in [-1, 1]: observation, reward, end."""
        self.env.np_random = Scripted([0.5 * (1.0 + x) for x in noise])
        observation, reward, terminated, _, _ = self.env.step(np.asarray(action, np.float64))
        return observation, float(reward), terminated

    @property
    def terrain(self):
        """Its 11 heights, in metres."""
        return np.array([polygon[0][1] for polygon in self.env.sky_polys] + [self.env.sky_polys[-1][1][1]])

    @property
    def bodies(self):
        """Mass, centre and inertia about it of the hull, the right and the left leg; places in the world."""
        bodies = [self.env.lander, *self.env.legs]
        offsets = [np.array(b.localCenter) for b in bodies]
        inertias = [b.inertia - b.mass * (o @ o) for b, o in zip(bodies, offsets, strict=True)]
        return [(b.mass, np.array(b.worldCenter), i) for b, i in zip(bodies, inertias, strict=True)]

    @property
    def legs(self):
        """Angles of the joints of the right and of the left leg, outwards, in radians."""
        right, left = self.env.legs
        return np.array([right.joint.angle, -left.joint.angle])

    def place(self, position, angle, velocity, spin):
        """Move it as one rigid body: the hull's origin, and the velocity of the centre of mass."""
        hull, legs = self.env.lander, self.env.legs
        position, mass = np.asarray(position, float), sum(m for m, _, _ in self.bodies)
        back, turn = rotation(-hull.angle), rotation(angle)
        offsets = [back @ np.array(leg.position - hull.position) for leg in legs]
        angles = [leg.angle - hull.angle for leg in legs]
        hull.position, hull.angle = tuple(position), angle
        for leg, offset, relative in zip(legs, offsets, angles, strict=True):
            leg.position, leg.angle = tuple(position + turn @ offset), angle + relative
        centre = sum(m * c for m, c, _ in self.bodies) / mass
        for body in (hull, *legs):
            x, y = np.array(body.worldCenter) - centre
            body.linearVelocity = (velocity[0] - spin * y, velocity[1] + spin * x)
            body.angularVelocity = spin
            body.awake = True
        self.env.game_over = False
        for leg in legs:
            leg.ground_contact = False


def rotation(angle):
    """Anticlockwise."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
