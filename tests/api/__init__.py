"""Tests of `bojax.api`."""
