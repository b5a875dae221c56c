"""A robot surveys a pond with an island: it plans, drives a part of the plan, measures, and plans again."""

import time
from pathlib import Path

import numpy as np

import bojax


class Robot:
    """A simulated robot that drives straight to each waypoint and measures the depth on the way."""

    def __init__(self, position: np.ndarray, spacing: float):
        self.position, self.spacing = position, spacing
        self.random = np.random.default_rng(0)

    def drive(self, waypoints: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Follow waypoints for a distance, and return the positions and depths measured."""
        points = []
        for waypoint in waypoints:
            while (gap := float(np.linalg.norm(waypoint - self.position))) > 1e-9 and distance > 0.0:
                step = min(self.spacing, gap, distance)
                self.position = self.position + step / gap * (waypoint - self.position)
                distance -= step
                points.append(self.position)
        points = np.array(points).reshape(-1, 2)
        depths = 5.0 + 2.0 * np.sin(points[:, 0] / 15.0) + 0.04 * points[:, 1]
        return points, depths + 0.05 * self.random.standard_normal(len(points))


island = np.array([[40.0, 30.0], [60.0, 30.0], [50.0, 50.0]])
pond = bojax.Area.rectangle(0.0, 0.0, 100.0, 80.0).without([(island,)])
start = np.array([5.0, 5.0])
mission = bojax.Mission(pond, budget=300.0, start=start, end=start, spacing=2.0, relearn_every=50)
robot = Robot(start, mission.spacing)
saved = Path("mission.npz")
while mission.remaining > mission.spacing:
    began = time.perf_counter()
    waypoints = mission.plan()
    seconds = time.perf_counter() - began
    if len(waypoints) == 0:
        break
    points, depths = robot.drive(waypoints, min(75.0, mission.remaining))
    if mission.observe(points, depths, robot.position) == 0:
        break
    mission.save(saved)  # after a crash: mission = bojax.Mission.load(saved)
    print(f"{mission.remaining:.0f} m left, {mission.num_measurements} depths, planned in {seconds:.1f} s")
mean, deviation = mission.predict(pond.grid(5.0))
print(f"depths from {mean.min():.1f} to {mean.max():.1f} m, mean deviation {deviation.mean():.2f} m")
