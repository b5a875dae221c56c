"""Learners, the features they use, and the schedules of their exploration."""
