"""VDP Tag in plain Python numbers, for peers that are written in Python."""

import math
import random

TARGET_NOISE, TAG_RADIUS, NUM_BEAMS, NOISE, LOOK_NOISE, EMPTY = 0.05, 0.1, 8, 5.0, 0.1, 1.0
Point = tuple[float, float]


def drift(x: float, y: float) -> Point:
    """The target's next position without noise."""

    def velocity(x, y):
        return 2.0 * (x - x**3 / 3.0 - y), x / 2.0

    h = 0.1
    for _ in range(5):
        a = velocity(x, y)
        b = velocity(x + h / 2 * a[0], y + h / 2 * a[1])
        c = velocity(x + h / 2 * b[0], y + h / 2 * b[1])
        d = velocity(x + h * c[0], y + h * c[1])
        x += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        y += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
    return x, y


def move(x: float, y: float, angle: float) -> Point:
    """The agent's next position, in front of the first barrier."""
    dx, dy = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
    share = 1.0
    for ux, uy in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        cross = 2.8 * (ux * dy - uy * dx)
        if cross != 0.0:
            u = ((x - 0.2 * ux) * 2.8 * uy - (y - 0.2 * uy) * 2.8 * ux) / cross
            t = ((x - 0.2 * ux) * dy - (y - 0.2 * uy) * dx) / cross
            if 0.0 <= u < share and 0.0 <= t <= 1.0:
                share = u - 4.4e-16
    return x + share * dx, y + share * dy


def step(agent: Point, target: Point, angle: float) -> tuple[Point, Point, bool]:
    """A draw of the next positions, and whether the target is tagged."""
    (x, y), agent = drift(*target), move(*agent, angle)
    target = x + random.gauss(0.0, TARGET_NOISE), y + random.gauss(0.0, TARGET_NOISE)
    return agent, target, math.dist(agent, target) < TAG_RADIUS


def reward(is_tagged: bool, look: bool) -> float:
    """The reward of a step."""
    return (100.0 if is_tagged else -1.0) - 5.0 * look


def readings(agent: Point, target: Point, look: bool) -> list[float]:
    """A draw of the readings of all beams."""
    beam, distance = _towards(agent, target)
    drawn = [random.gauss(EMPTY, NOISE) for _ in range(NUM_BEAMS)]
    drawn[beam] = random.gauss(distance, LOOK_NOISE if look else NOISE)
    return drawn


def log_density(seen: list[float], agent: Point, target: Point, look: bool) -> float:
    """Logarithm of the density of readings."""
    beam, distance = _towards(agent, target)
    total = 0.0
    for index, value in enumerate(seen):
        mean, noise = (distance, LOOK_NOISE if look else NOISE) if index == beam else (EMPTY, NOISE)
        total -= 0.5 * ((value - mean) / noise) ** 2 + math.log(noise) + _HALF_LOG_2_PI
    return total


_HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)


def _towards(agent: Point, target: Point) -> tuple[int, float]:
    """The beam that the target is in, and its distance."""
    dx, dy = target[0] - agent[0], target[1] - agent[1]
    share = (math.atan2(dy, dx) % (2.0 * math.pi)) / (2.0 * math.pi)
    return math.ceil(NUM_BEAMS * share) - 1, math.hypot(dx, dy)
