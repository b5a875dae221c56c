"""`features: auto` chooses settings by the spaces of an environment, and is then as if they were written."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.engine.devices import find_devices
from bojax.engine.plan import make_plan
from bojax.envs.spaces import Box, Discrete
from bojax.learning.auto_features import AutoSpec, chosen
from bojax.learning.settings import OneHot, RandomFourierFeatures


def box(num_dims):
    return Box(jnp.zeros(num_dims), jnp.ones(num_dims))


@pytest.mark.parametrize(
    ("observations", "actions", "numbers"),
    [
        (box(1), box(1), (300, 0.3, 3.0)),
        (box(2), box(1), (300, 0.3, 3.0)),
        (box(3), box(1), (300, 0.37, 3.0)),
        (box(4), box(1), (500, 0.42, 3.0)),
        (box(8), box(2), (500, 0.6, 3.0)),
        (box(2), Discrete(5), (300, 0.3, 0.3)),
        (Discrete(500), box(1), (300, 0.3, 3.0)),
        (Discrete(500), Discrete(6), (300, 0.3, 0.3)),
    ],
)
def test_the_rule(observations, actions, numbers):
    found = chosen(observations, actions)
    assert isinstance(found, RandomFourierFeatures)
    assert (found.num_features, found.state_lengthscale, found.action_lengthscale) == numbers


def test_few_discrete_states_and_actions_have_a_feature_each():
    assert chosen(Discrete(200), Discrete(5)) == OneHot()


@pytest.mark.parametrize("spaces", [(box(2), box(1)), (Discrete(4), Discrete(3))], ids=["boxes", "discrete"])
def test_features_are_those_of_the_settings_they_stand_for(spaces):
    specs = AutoSpec(), build(chosen(*spaces), "float32")
    ours, theirs = (each.draw(jax.random.key(0), *spaces, jnp.dtype("float32")) for each in specs)
    assert eqx.tree_equal(*jax.device_get((ours, theirs)))


@pytest.mark.parametrize(
    ("env", "expected"),
    [
        ("mountain-car", RandomFourierFeatures(state_lengthscale=0.3, action_lengthscale=3.0)),
        ("chain", OneHot()),
    ],
)
def test_the_plan_has_explicit_settings(env, expected):
    sweep = load_config("mountain-car", [f"env={env}", "learner.features=auto"])
    (point,) = make_plan(sweep, find_devices("cpu")).content["points"]
    assert point["config"]["learner"]["features"] == expected.model_dump()
