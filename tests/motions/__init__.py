"""Tests of `bojax.motions`."""
