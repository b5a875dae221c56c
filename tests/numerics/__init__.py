"""Tests of `bojax.numerics`."""
