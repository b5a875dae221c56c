"""A robot of a mission: where it is, and what it may still drive."""

import dataclasses

import numpy as np

from bojax.surveys.polylines import Waypoints, length_of
from bojax.surveys.route import Route


@dataclasses.dataclass
class Robot:
    """What a mission knows of a robot."""

    position: Waypoints  # where it is, m
    remaining: float  # distance left, m
    end: Waypoints | None = None  # its last position, m; None for anywhere
    route: Route | None = None  # its last plan
    time: float = -np.inf  # latest time of its measurements

    def drive(self, points: Waypoints, pose: Waypoints | None) -> None:
        """Go along points `[N, 2]` to a pose, if there is one, and take the length from what is left."""
        way = [self.position, *points] + ([] if pose is None else [pose])
        self.remaining = max(self.remaining - length_of(np.array(way)), 0.0)
        self.position = np.array(way[-1])
