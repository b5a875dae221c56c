"""Tests of `bojax.experiments`."""
