"""Planners: algorithms that choose the next path of a robot from its belief."""
