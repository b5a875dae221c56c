"""Robots simulated by MJX that a learner acts in."""
