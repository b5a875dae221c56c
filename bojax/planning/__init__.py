"""Planners: how a robot chooses its next path from a belief."""
