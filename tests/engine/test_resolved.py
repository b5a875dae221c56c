"""Settings that are left to the machine stand in the plan with the values that were chosen there."""

import jax
import pytest

import bojax.robots.simulator
from bojax.config.sweep import load_config
from bojax.engine.plan import make_plan


def content(name: str, *changes: str):
    return make_plan(load_config(name, list(changes)), jax.devices()[:1]).content


@pytest.mark.parametrize(
    ("name", "path"),
    [("reacher", ("env",)), ("hilly-terrain", ("problem", "vehicle"))],
)
def test_the_implementation_of_mjx_is_part_of_the_plan(monkeypatch, name, path):
    plans = {}
    for impl in ("jax", "warp"):
        monkeypatch.setattr(bojax.robots.simulator, "_has_warp_on_gpu", lambda impl=impl: impl == "warp")
        monkeypatch.setattr(bojax.robots.simulator, "_stepping", lambda *_: None)
        plans[impl] = config = content(name)["points"][0]["config"]
        for part in path:
            config = config[part]
        assert config["physics"]["impl"] == impl
    assert plans["jax"] != plans["warp"]
    explicit = content(name, f"{'.'.join(path)}.physics.impl=jax")
    assert explicit["points"][0]["config"] == plans["jax"]


def test_a_plan_without_such_settings_has_the_config_as_it_is():
    sweep = load_config("mountain-car", [])
    plan = make_plan(sweep, jax.devices()[:1])
    assert plan.content["points"][0]["config"] == sweep.points[0].config.model_dump(mode="json")
