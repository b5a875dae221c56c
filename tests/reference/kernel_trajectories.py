"""Kernel trajectories, formula by formula (4.6-4.9), without the shortcuts of the compiled code."""

import numpy as np
from scipy.special import erf


class KernelTrajectory:
    """The curve T(y), y in [0, 1], through the anchor points that `params` describe (Fig. 4.1).

    Lengths are in units of the trajectory's length until `path` scales them.
    """

    def __init__(
        self,
        params,
        first_angle,
        turn_angle,
        space_lengthscale,
        time_lengthscale,
        epsilon,
        delta,
        start="pose",
    ):
        self.anchors = anchor_points(params, first_angle, turn_angle)
        self.times = np.linspace(0.0, 1.0, len(self.anchors))
        self.time_lengthscale = time_lengthscale
        self.delta = delta
        self.start = start
        self.time_gram = np.stack([self.k_y(t) for t in self.times])
        distance = np.linalg.norm(self.anchors[:, None] - self.anchors[None, :], axis=-1)
        space_gram = np.exp(-0.5 * (distance / space_lengthscale) ** 2)
        n = len(self.anchors)
        m_pi = uniform_embedding(self.anchors, space_lengthscale)
        self.big_lambda = np.diag(np.linalg.solve(space_gram + n * epsilon * np.eye(n), m_pi))  # (4.9)

    # Of one time, or of many: then a row each.

    def k_y(self, y):
        return np.exp(-0.5 * (np.subtract.outer(y, self.times) / self.time_lengthscale) ** 2)

    def k_y_dot(self, y):
        return -np.subtract.outer(y, self.times) / self.time_lengthscale**2 * self.k_y(y)

    def weights(self, k_y):
        """(4.8)"""
        a = self.big_lambda @ self.time_gram
        return (a @ np.linalg.solve(a @ a + self.delta * np.eye(len(a)), self.big_lambda @ k_y.T)).T

    def expected(self, y):
        """(4.7)"""
        return self.weights(self.k_y(y)) @ self.anchors

    def expected_dot(self, y):
        return self.weights(self.k_y_dot(y)) @ self.anchors

    def position(self, y):
        """T(y), moved to the origin, and bent onto the heading with `start="pose"`."""
        bend = np.multiply.outer(y * (1.0 - y) ** 2, self.misfit)
        return self.expected(y) - self.expected(0.0) + bend

    def velocity(self, y):
        return self.expected_dot(y) + np.multiply.outer((1.0 - y) * (1.0 - 3.0 * y), self.misfit)

    @property
    def misfit(self):
        if self.start == "relaxed":
            return np.zeros(2)
        return np.array([1.0, 0.0]) - self.expected_dot(0.0)

    def path(self, length, num_samples, num_chords=2000):
        """Poses at equal arc lengths, measured along many chords."""
        ys = np.linspace(0.0, 1.0, num_chords + 1)
        steps = np.linalg.norm(np.diff(self.position(ys), axis=0), axis=1)
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.interp(arc[-1] * np.arange(1, num_samples + 1) / num_samples, arc, ys)
        x_dot, y_dot = self.velocity(at).T
        return np.column_stack([self.position(at) * length / arc[-1], np.arctan2(y_dot, x_dot)])


def anchor_points(params, first_angle, turn_angle):
    """Equally spaced points, the robot's position first; each parameter turns one segment (Fig. 4.1)."""
    points, heading = [np.zeros(2)], 0.0
    for i, theta in enumerate(params):
        heading += theta * (first_angle if i == 0 else turn_angle)
        points.append(points[-1] + np.array([np.cos(heading), np.sin(heading)]) / len(params))
    return np.array(points)


def uniform_embedding(points, lengthscale):
    """m_pi of (4.9): the mean of k(x, u) over u uniform on [-1, 1]^2."""

    def mean_1d(x):
        s = np.sqrt(2.0) * lengthscale
        return np.sqrt(np.pi) / 4.0 * s * (erf((1.0 - x) / s) + erf((1.0 + x) / s))

    return mean_1d(points[:, 0]) * mean_1d(points[:, 1])
