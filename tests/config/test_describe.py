"""Descriptions of settings."""

from bojax.config.describe import settings_of
from bojax.config.settings import EngineConfig
from bojax.motions.settings import Splines
from bojax.planning.settings import SBO


def test_a_setting_has_type_default_and_meaning():
    settings = {setting.name: setting for setting in settings_of(Splines)}
    assert (settings["actions"].type, settings["actions"].default) == ("5 | 9 | 17", "5")
    assert (settings["length"].type, settings["length"].default) == ("number > 0", "1")
    assert "kind" not in settings and settings["length"].meaning.endswith(", m")


def test_parts_bounds_and_nulls():
    settings = {setting.name: setting.type for setting in settings_of(SBO)}
    assert settings["motions"] == "motions"
    assert settings["discount"] == "number > 0, <= 1"
    engine = {setting.name: (setting.type, setting.default) for setting in settings_of(EngineConfig)}
    assert engine["lanes_per_device"] == ("integer >= 1 | null", "null")
    assert engine["segment_seconds"] == ("number > 0", "2")
