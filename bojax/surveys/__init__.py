"""Surveys of an area: what a route teaches about a field, routes, and missions."""
