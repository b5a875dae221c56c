"""Tests of `bojax.models`."""
