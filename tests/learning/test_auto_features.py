"""`features: auto` chooses settings by the spaces of an environment, and is then as if they were written."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.engine.devices import find_devices
from bojax.engine.plan import make_plan
from bojax.envs.spaces import Box, Discrete
from bojax.learning.auto_features import chosen
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


@pytest.mark.parametrize("learner", ["emu-q", "rff-q"])
def test_a_run_is_that_of_the_settings_it_stands_for(learner):
    """The program of an episode is the same text, and its numbers are the same."""
    key, programs, numbers = jax.random.key(0), [], []
    for features in ("auto", "{num_features: 300, state_lengthscale: 0.3, action_lengthscale: 3.0}"):
        words = ["env.max_steps=20", "episodes=2", f"learner={{kind: {learner}, features: {features}}}"]
        arrays, static = eqx.partition(build(load_config("point-maze", words).points[0].config), eqx.is_array)

        def episode(arrays, key, static=static):
            experiment = eqx.combine(arrays, static)
            return jax.tree.leaves(experiment.advance(experiment.init(key)))

        programs.append(jax.jit(episode).lower(arrays, key).as_text())
        numbers.append(jax.tree.leaves(arrays))
    assert programs[0] == programs[1]
    for ours, theirs in zip(*numbers, strict=True):
        np.testing.assert_array_equal(ours, theirs)


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
