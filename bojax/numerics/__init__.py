"""Numerics shared by every model: linear algebra, quasi-random points, lanes of a batch."""
