"""Vehicles: how a robot follows a planned path in the world, exactly or simulated with a controller."""
