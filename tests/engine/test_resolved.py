"""Settings that are left to the machine stand in the plan with the values that were chosen there."""

import jax
import pytest

import bojax.robots.simulator
from bojax.config.sweep import load_config
from bojax.engine.plan import make_plan, plan_made_elsewhere


def content(name: str, *changes: str):
    return make_plan(load_config(name, list(changes)), jax.devices()[:1]).content


@pytest.mark.parametrize(
    ("name", "path"),
    [("hopper", ("env",)), ("robot-parking", ("problem", "vehicle"))],
)
def test_the_implementation_of_the_physics_is_part_of_the_plan(monkeypatch, name, path):
    plans = {}
    monkeypatch.setattr(bojax.robots.simulator, "_stepping", lambda *_: None)
    monkeypatch.setattr(bojax.robots.simulator, "kernels_run_here", lambda: False)
    for impl, platform in (("jax", "gpu"), ("c", "cpu")):
        monkeypatch.setattr(jax, "default_backend", lambda platform=platform: platform)
        plans[impl] = config = content(name)["points"][0]["config"]
        for part in path:
            config = config[part]
        assert config["physics"]["impl"] == impl
    assert plans["jax"] != plans["c"]
    explicit = content(name, f"{'.'.join(path)}.physics.impl=jax")
    assert explicit["points"][0]["config"] == plans["jax"]


def test_a_plan_without_such_settings_has_the_config_as_it_is():
    sweep = load_config("mountain-car", [])
    plan = make_plan(sweep, jax.devices()[:1])
    assert plan.content["points"][0]["config"] == sweep.points[0].config.model_dump(mode="json")


def test_a_driver_without_a_gpu_takes_the_plan_of_a_worker_with_kernels():
    sweep = load_config("hopper", [])
    own = make_plan(sweep, jax.devices()[:1])
    (point,) = own.content["points"]
    config = {**point["config"], "env": {**point["config"]["env"], "physics": {"impl": "pallas"}}}
    content = {**own.content, "points": [{**point, "config": config}]}
    plan = plan_made_elsewhere(sweep, content, {"platform": "gpu", "kind": "A"})
    assert plan.content["points"][0]["config"]["env"]["physics"]["impl"] == "pallas"
    assert plan.content["device"] == {"platform": "gpu", "kind": "A"}
