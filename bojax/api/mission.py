"""Surveys that go on: `Mission`, and the `Area` that it surveys."""

from bojax.surveys.area import Area as Area
from bojax.surveys.mission import Mission as Mission
