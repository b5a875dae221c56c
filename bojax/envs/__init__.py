"""Environments for learners, with declared bounds, written for one lane."""
