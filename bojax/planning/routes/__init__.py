"""Planners that follow routes from files."""
