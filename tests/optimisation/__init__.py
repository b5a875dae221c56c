"""Tests of `bojax.tuning`."""
