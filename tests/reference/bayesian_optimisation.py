"""Bayesian optimisation as in Algorithm 1, refitting the process at every step."""

import numpy as np

from tests.reference.gaussian_process import GP, LinearMean


def maximise(function, kernel, acquisition, noise_variance, num_initial, refine_steps, initial, candidates):
    """The points of Algorithm 1 and the values there, in the box [-1, 1]^D.

    Args:
        function: The objective, which may give NaN.
        kernel: Kernel of the process.
        acquisition: The h of Algorithm 1.
        noise_variance: Noise of the process.
        num_initial: First observations, made at the points of `initial`.
        refine_steps: Gradient steps from the best candidate.
        initial: A point for each iteration.
        candidates: Candidates of each iteration.
    """
    xs, ys, is_random = [], [], True
    for i in range(len(candidates)):
        x = (
            initial[i]
            if is_random
            else best_point(kernel, acquisition, noise_variance, refine_steps)(
                *observed(xs, ys), candidates[i]
            )
        )
        xs.append(x)
        ys.append(function(x))
        is_random = np.isfinite(ys).sum() < num_initial or not np.isfinite(ys[-1])
    return np.array(xs), np.array(ys)


def observed(xs, ys):
    seen = np.isfinite(ys)
    return np.array(xs)[seen], np.array(ys)[seen]


def best_point(kernel, acquisition, noise_variance, refine_steps):
    """arg max of the acquisition: the best candidate, then signed steps that halve on failure."""

    def find(x, y, candidates):
        values = (y - y.mean()) / (y.std() if np.ptp(y) > 0.0 else 1.0)
        gp = GP(kernel, LinearMean(), noise_variance, x, values)

        def score(points):
            mean, covariance = gp.predict(points)
            return acquisition(mean, np.sqrt(np.maximum(np.diag(covariance), 0.0)), values.max())

        point, size = candidates[np.argmax(score(candidates))], 0.1
        for _ in range(refine_steps):
            proposal = np.clip(point + size * np.sign(gradient(score, point)), -1.0, 1.0)
            if score(proposal[None])[0] > score(point[None])[0]:
                point = proposal
            else:
                size *= 0.5
        return point

    return find


def gradient(score, point, h=1e-5):
    steps = h * np.eye(len(point))
    return (score(point + steps) - score(point - steps)) / (2.0 * h)
