"""Families of trajectories in the robot's own frame."""
