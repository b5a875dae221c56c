"""Kernel Bayes' rule for trajectories in plain NumPy, equation by equation (4.6-4.9)."""

import numpy as np


def rbf(a: np.ndarray, b: np.ndarray, lengthscale: float) -> np.ndarray:
    """Squared exponential kernel between the rows of `a` and the rows of `b`."""
    squared = ((a[:, None, :] - b[None, :, :]) ** 2).sum(axis=-1)
    return np.exp(-0.5 * squared / lengthscale**2)


def prior_embedding(anchors: np.ndarray, points: np.ndarray, space_lengthscale: float) -> np.ndarray:
    """m_pi (text below 4.9): mean of k_x(x_i, u_j) over points u_j drawn from the prior."""
    return rbf(anchors, points, space_lengthscale).mean(axis=1)


def weights(
    y: float,
    anchors: np.ndarray,
    times: np.ndarray,
    m_pi: np.ndarray,
    space_lengthscale: float,
    time_lengthscale: float,
    epsilon: float,
    delta: float,
) -> np.ndarray:
    """w(y) of (4.8), with Lambda of (4.9)."""
    n = len(anchors)
    times = times[:, None]
    g_x = rbf(anchors, anchors, space_lengthscale)
    g_y = rbf(times, times, time_lengthscale)
    k_y = rbf(times, np.array([[y]]), time_lengthscale)[:, 0]
    lam = np.diag(np.linalg.inv(g_x + n * epsilon * np.eye(n)) @ m_pi)
    return lam @ g_y @ np.linalg.inv(lam @ g_y @ lam @ g_y + delta * np.eye(n)) @ lam @ k_y


def trajectory(ys: np.ndarray, anchors: np.ndarray, *args) -> np.ndarray:
    """T(y) of (4.7) at each time."""
    return np.stack([weights(y, anchors, *args) @ anchors for y in ys])
