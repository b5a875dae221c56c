"""Tests of `bojax.cli`."""
