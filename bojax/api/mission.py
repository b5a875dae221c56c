"""Surveys that go on: `Mission`, and the `Area` that it surveys."""

from bojax.areas.area import Area as Area
from bojax.surveys.mission import Mission as Mission
