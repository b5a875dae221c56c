"""Tests that hold for every part of a role, found by discovery."""
