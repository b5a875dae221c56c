"""Smooth curves through the poses of a path: a polyline through its few samples would look angular."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.report.statistics import Floats

_POINTS = 8  # number of points of a curve from one pose to the next


def smooth(start: Floats, poses: Floats) -> Floats:
    """A cubic Hermite curve from a start through poses `[S, 3]`, along the heading of each.

    The heading of the start, `[2 or more]`, is not used, because a trajectory need not begin along it: the
    first segment is the parabola that ends along the first heading. The result, `[8 S + 1, 2]`, includes the
    start and every pose.
    """
    ends = np.concatenate([np.asarray(start)[None, :2], poses[:, :2]])
    chords = np.diff(ends, axis=0)
    headings = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    lengths = np.linalg.norm(chords, axis=1, keepdims=True)
    # A robot in reverse moves against its heading.
    arriving = _along(headings, chords) * lengths
    leaving = np.concatenate([2 * chords[:1] - arriving[:1], _along(headings[:-1], chords[1:]) * lengths[1:]])
    u = (np.arange(1, _POINTS + 1) / _POINTS)[None, :, None]
    pieces = (
        (2 * u**3 - 3 * u**2 + 1) * ends[:-1, None]
        + (u**3 - 2 * u**2 + u) * leaving[:, None]
        + (3 * u**2 - 2 * u**3) * ends[1:, None]
        + (u**3 - u**2) * arriving[:, None]
    )
    return np.concatenate([ends[:1], pieces.reshape(-1, 2)])


def driven(arrays: Mapping[str, NDArray[Any]]) -> tuple[list[Floats], list[Floats], Floats]:
    """A recorded path: the poses between its steps, the poses `[S, 3]` of each step, and a curve `[N, 2]`.

    Only finite poses count, and the curve through them is smooth. Without a recorded start, the path starts
    at its first pose; without any pose, everything is empty.
    """
    steps = [step[np.isfinite(step).all(axis=1)] for step in np.asarray(arrays["paths"], dtype=np.float64)]
    steps = [step for step in steps if len(step)]
    if "start" not in arrays and not steps:
        return [], [], np.zeros((0, 2))
    start = np.asarray(arrays["start"] if "start" in arrays else steps[0][0], dtype=np.float64)
    ends = [start, *(step[-1] for step in steps)]
    curves = [smooth(begin, step) for begin, step in zip(ends, steps, strict=False)]
    return ends, steps, np.concatenate(curves or [start[None, :2]])


def _along(headings: Floats, chords: Floats) -> Floats:
    return np.where((headings * chords).sum(axis=1, keepdims=True) < 0, -headings, headings)
