"""Robots in MuJoCo: models, their simulation by MJX, sensors and controllers."""
