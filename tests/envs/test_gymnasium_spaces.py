"""Spaces of several parts: observations as Gymnasium flattens them, actions one for each combination."""

import math

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.spaces.utils import flatdim, flatten

from bojax.engine.training import train
from bojax.envs.gymnasium_spaces import GymnasiumAdapter, from_gymnasium
from bojax.envs.spaces import Box, Discrete
from bojax.numerics.trial import Misfit

GOAL = spaces.Dict(
    observation=spaces.Box(-1.0, 2.0, (2, 3)),
    direction=spaces.Discrete(4, start=-1),
    inner=spaces.Tuple(
        [spaces.MultiDiscrete([[2, 3], [4, 1]], start=[[5, 0], [0, 0]]), spaces.MultiBinary(2)]
    ),
)
CARDS = spaces.Tuple([spaces.Discrete(32), spaces.Discrete(11), spaces.Discrete(2)])
OBSERVATIONS = [GOAL, CARDS, spaces.MultiDiscrete([3, 2]), spaces.MultiBinary((2, 2)), spaces.Dict(a=CARDS)]
ACTIONS = [
    (spaces.MultiDiscrete([3, 2]), 6),
    (spaces.MultiDiscrete([2, 2], start=[4, -1]), 4),
    (spaces.MultiBinary(3), 8),
    (spaces.MultiBinary((2, 1)), 4),
    (spaces.Tuple([spaces.Discrete(2, start=1), spaces.MultiDiscrete([2, 3])]), 12),
    (spaces.Dict(b=spaces.Discrete(3), a=spaces.Tuple([spaces.MultiBinary(2)])), 12),
]


def adapter(observation, action):
    found = (
        from_gymnasium(observation, "observation", jnp.float32),
        from_gymnasium(action, "action", jnp.float32),
    )
    return GymnasiumAdapter((observation, action), *found)


def hashable(value):
    """An action that can be compared with others."""
    if isinstance(value, dict):
        return tuple((key, hashable(part)) for key, part in sorted(value.items()))
    if isinstance(value, tuple):
        return tuple(map(hashable, value))
    return tuple(np.ravel(value).tolist())


@pytest.mark.parametrize("space", OBSERVATIONS, ids=str)
def test_observations_are_those_that_gymnasium_flattens_within_their_bounds(space):
    space.seed(0)
    found = from_gymnasium(space, "observation", jnp.float32)
    assert isinstance(found, Box) and found.num_dims == flatdim(space)
    convert = adapter(space, spaces.Discrete(2)).observation
    for _ in range(20):
        value = space.sample()
        vector = convert(value)
        np.testing.assert_array_equal(vector, np.asarray(flatten(space, value), np.float32))
        assert vector.dtype == np.float32
        assert (vector >= found.low).all() and (vector <= found.high).all()


@pytest.mark.parametrize(("space", "num"), ACTIONS, ids=str)
def test_each_combination_is_one_action(space, num):
    found = from_gymnasium(space, "action", jnp.float32)
    assert isinstance(found, Discrete) and found.num == num
    actions = [adapter(CARDS, space).action(np.int32(number)) for number in range(num)]
    assert all(space.contains(action) for action in actions)
    assert len({hashable(action) for action in actions}) == num
    assert [hashable(a) for a in (adapter(CARDS, space).action(-3), adapter(CARDS, space).action(99))] == [
        hashable(actions[0]),
        hashable(actions[-1]),
    ]


def test_the_last_part_of_an_action_changes_fastest():
    action = adapter(CARDS, spaces.MultiDiscrete([3, 2])).action
    assert [action(number).tolist() for number in range(6)] == [
        [0, 0],
        [0, 1],
        [1, 0],
        [1, 1],
        [2, 0],
        [2, 1],
    ]


def test_a_dictionary_of_boxes_is_one_vector_that_is_clipped_and_rounded():
    space = spaces.Dict(arm=spaces.Box(-1.0, 1.0, (2,)), gear=spaces.Box(0, 4, (2, 1), np.int64))
    found = from_gymnasium(space, "action", jnp.float32)
    assert isinstance(found, Box) and found.high.tolist() == [1, 1, 4, 4]
    action = adapter(CARDS, space).action(np.array([0.5, -7.0, 1.7, 9.0], np.float32))
    assert space.contains(action)
    assert action["arm"].tolist() == [0.5, -1.0] and action["gear"].tolist() == [[2], [4]]


@pytest.mark.parametrize(
    ("space", "value", "message"),
    [
        (GOAL, [1, 2], "got an observation with list; allowed: observation, direction, inner"),
        (
            GOAL,
            {"observation": 1},
            "got an observation with observation; allowed: observation, direction, inner",
        ),
        (CARDS, (1, 2), "got an observation with 2; allowed: 3 values"),
        (CARDS, (1, 2, 3), "got an observation with 2 of 3; allowed: 0 to 1"),
        (CARDS, (1, 2, -1), "got an observation with 2 of -1; allowed: 0 to 1"),
        (CARDS, (1, 0.5, 0), "got an observation with 1 of dtype float64; allowed: integers"),
        (spaces.Dict(a=CARDS), {"a": (1, 2)}, "got an observation in a with 2; allowed: 3 values"),
        (spaces.MultiBinary(2), [0, 2], r"got an observation of \[0 2\]; allowed: an element of MultiBinary"),
        (spaces.MultiDiscrete([2, 2]), [0, -1], "allowed: an element of MultiDiscrete"),
        (spaces.MultiBinary(2), [0, 1, 1], r"got an observation of shape \(3,\), not \(2,\)"),
    ],
)
def test_an_observation_that_does_not_fit_is_refused(space, value, message):
    with pytest.raises(Misfit, match=message):
        adapter(space, spaces.Discrete(2)).observation(value)


class Lock(gymnasium.Env):
    """Two dials and a switch; the observation says what was set, and the right setting ends the episode."""

    observation_space = spaces.Dict(dials=spaces.MultiDiscrete([3, 3]), switch=spaces.Discrete(2))
    action_space = spaces.Tuple([spaces.MultiDiscrete([3, 3]), spaces.Discrete(2)])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return {"dials": np.array([0, 0]), "switch": 0}, {}

    def step(self, action):
        assert self.action_space.contains(action), action
        dials, switch = action
        opens = dials.tolist() == [2, 1] and int(switch) == 1
        return {"dials": dials, "switch": switch}, float(opens), opens, False, {}


def test_a_learner_learns_on_parts_and_its_policy_takes_them():
    gymnasium.register("Lock-v0", Lock, max_episode_steps=10)
    try:
        features = {"num_features": 32}
        learner = {"kind": "rff-q", "features": features}
        env = {"kind": "gymnasium", "id": "Lock-v0", "success": "terminated"}
        trained = train(env, learner, episodes=12)
        assert trained.experiment.env.observation_space.num_dims == 8
        assert trained.experiment.env.action_space.num == math.prod([3, 3, 2])
        world = gymnasium.make("Lock-v0")
        observation, _ = world.reset(seed=0)
        action = trained.policy()(observation)
        assert world.action_space.contains(action)
        world.step(action)
    finally:
        del gymnasium.registry["Lock-v0"]


def test_blackjack_is_played():
    env = {"kind": "gymnasium", "id": "Blackjack-v1", "max_steps": 12}
    trained = train(env, {"kind": "rff-q", "features": {"num_features": 16}}, episodes=2)
    assert trained.experiment.env.observation_space.num_dims == 32 + 11 + 2
    assert trained.policy()((14, 10, 0)) in (0, 1)
