"""Scalar fields over the plane, which a robot monitors."""
