"""What the page of the environments says of them is so."""

import re

import pytest
import yaml

from bojax.config import catalog
from bojax.config.describe import settings_of
from bojax.envs import settings as envs
from bojax.experiments.settings import Learning
from tests.examples.pages import ROOT, blocks

PAGE = ROOT / "docs" / "environments.md"
CONTINUOUS = (envs.SinglePendulum, envs.MountainCar, envs.DoublePendulum, envs.CartpoleSwingUp)


def text() -> str:
    return re.sub(r"^```.*?^```$", "", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)


def test_every_setting_is_named():
    named = set(re.findall(r"`(\w+)[`:]", text()))
    for schema in (*CONTINUOUS, envs.Gymnasium):
        assert {setting.name for setting in settings_of(schema)} - {"reward"} <= named
    brax = next(yaml.safe_load(c)["env"] for k, c, _ in blocks(PAGE) if k == "yaml" and "kind: brax" in c)
    assert {*brax, "max_steps"} == set(envs.Brax.model_fields)


@pytest.mark.parametrize("schema", CONTINUOUS, ids=lambda s: s.__name__)
def test_the_defaults_are_the_ones_that_are_told(schema):
    kind = schema.model_fields["kind"].default
    row = next(line for line in text().splitlines() if line.startswith(f"| `{kind}` |"))
    told = {name: float(value) for name, value in re.findall(r"`(\w+)` = ([\d.]+)", row)}
    assert told
    for name, value in told.items():
        assert schema.model_fields[name].default == value


@pytest.mark.parametrize("kind", ["gymnasium", "brax"])
def test_the_configs_that_are_shown_load(kind):
    shown = [yaml.safe_load(c) for k, c, _ in blocks(PAGE) if k == "yaml"]
    (env,) = [part["env"] for part in shown if part["env"]["kind"] == kind]
    assert "emu-q" in catalog.kinds("learner")
    assert Learning.model_validate({"env": env, "learner": "emu-q"}).env.kind == kind
