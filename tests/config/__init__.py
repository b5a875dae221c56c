"""Tests of `bojax.config`."""
