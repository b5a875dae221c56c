"""Tests of `bojax.acquisition`."""
