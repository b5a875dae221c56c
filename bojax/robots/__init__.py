"""Simulated robots: MuJoCo models, their simulation by MJX, sensors and controllers."""
