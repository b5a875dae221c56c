"""What the manifest says of a sweep."""

from dataclasses import replace

from bojax.engine.manifest import describe_sweep
from tests.toy import toy_sweep


def test_settings_changed_from_the_published_sweep_are_stated():
    sweep = replace(toy_sweep(), changed={"problem.half_width": [4.0, 3.0]})
    plan = {"runs": 2, "seed": 0, "record": {}, "config": {}, "points": []}
    manifest = describe_sweep(sweep, plan, [], "bojax sweep toy", "running")
    assert manifest["changed"] == {"problem.half_width": [4.0, 3.0]}
    assert describe_sweep(toy_sweep(), plan, [], "bojax sweep toy", "running")["changed"] == {}
