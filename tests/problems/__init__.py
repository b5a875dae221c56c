"""Tests of `bojax.problems`."""
