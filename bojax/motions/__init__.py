"""Motions: families of trajectories in the robot's frame."""
