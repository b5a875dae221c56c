"""Tests of `bojax.fields`."""
