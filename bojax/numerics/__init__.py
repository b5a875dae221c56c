"""Shared numerics: linear algebra, quasi-random points, angles, checkpoints, and the engine's batch axis."""
