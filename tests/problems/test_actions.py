"""Action spaces: what parameters decode to, what random actions are distributed as, what belongs to them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.problems.actions import Balls, Box, Discrete, Mixed

BOX = Box(jnp.asarray([0.0, -2.0]), jnp.asarray([1.0, 6.0]))
ANGLE_AND_LOOK = Mixed(Box(jnp.zeros(1), jnp.full(1, 2.0 * jnp.pi)), jnp.asarray([0.0, 1.0]))
LIST = Discrete(jnp.asarray([[-1.0], [0.0], [5.0]]))
BALLS = Balls(jnp.asarray(1.5), num_agents=2, num_dims=3)


def decoded(space, count=2000):
    """Parameters and actions of random actions."""
    parameters = jax.jit(jax.vmap(space.sample))(jax.random.split(jax.random.key(0), count))
    return np.asarray(parameters), np.asarray(jax.jit(jax.vmap(space.decode))(parameters))


@pytest.mark.parametrize("space", [BOX, ANGLE_AND_LOOK, LIST, BALLS])
def test_a_random_action_belongs_to_the_space_and_is_that_of_its_parameters(space):
    parameters, actions = decoded(space)
    assert parameters.shape[1] == space.size
    contains = jax.jit(jax.vmap(space.contains))
    assert np.all(contains(actions)) and not contains(actions + 100.0)[0]
    again = jax.jit(jax.vmap(lambda action: space.decode(space.encode(action))))(actions)
    np.testing.assert_allclose(again, actions, atol=1e-12)


def test_a_box_maps_its_corners():
    np.testing.assert_allclose(BOX.decode(jnp.asarray([-1.0, 1.0])), [0.0, 6.0])
    np.testing.assert_allclose(BOX.decode(jnp.zeros(2)), [0.5, 2.0])
    _, actions = decoded(BOX)
    for column, low, width in zip(actions.T, (0.0, -2.0), (1.0, 8.0), strict=True):
        assert stats.kstest(column, "uniform", (low, width)).pvalue > 1e-4


def test_angle_and_look():
    decode = jax.jit(lambda parameters: ANGLE_AND_LOOK.decode(parameters))
    for first in (-1.0, -0.3, 0.8):
        for second in (-1.0, -0.2, 0.0, 1e-9, 0.7, 1.0):
            action = decode(jnp.asarray([first, second]))
            np.testing.assert_allclose(action, [np.pi * (1.0 + first), float(second > 0.0)])
    _, actions = decoded(ANGLE_AND_LOOK)
    assert abs(actions[:, 1].mean() - 0.5) < 4.0 * 0.5 / 2000**0.5
    assert not ANGLE_AND_LOOK.contains(jnp.asarray([1.0, 0.5]))


def test_three_levels_divide_the_interval():
    space = Mixed(Box(jnp.zeros(1), jnp.ones(1)), jnp.asarray([3.0, 4.0, 7.0]))
    levels = [space.decode(jnp.asarray([0.0, p]))[1].item() for p in (-1.0, -0.4, -0.3, 0.3, 0.4, 1.0)]
    assert levels == [3.0, 3.0, 4.0, 4.0, 7.0, 7.0]


def test_a_list_is_drawn_from_uniformly():
    assert LIST.count == 3
    parameters, actions = decoded(LIST)
    np.testing.assert_array_equal(actions, np.asarray(LIST.values)[parameters[:, 0]])
    assert stats.chisquare(np.bincount(parameters[:, 0], minlength=3)).pvalue > 1e-4


def test_random_actions_are_uniform_in_balls():
    parameters, actions = decoded(BALLS)
    assert np.all(np.abs(parameters) <= 1.0)
    for vectors in np.split(actions, 2, axis=1):
        lengths = np.linalg.norm(vectors, axis=1)
        assert stats.kstest((lengths / 1.5) ** 3, "uniform").pvalue > 1e-4
        assert stats.kstest(vectors[:, 2] / lengths, "uniform", (-1.0, 2.0)).pvalue > 1e-4


def test_the_cube_is_scaled_to_a_ball():
    space = Balls(jnp.asarray(1.5), num_agents=1, num_dims=2)
    for parameters, action in [
        ((1.0, 0.0), (1.5, 0.0)),
        ((0.0, 0.0), (0.0, 0.0)),
        ((0.0, -0.5), (0.0, -0.75)),
    ]:
        np.testing.assert_allclose(space.decode(jnp.asarray(parameters)), action)
    corner = space.decode(jnp.asarray([1.0, -1.0]))
    np.testing.assert_allclose(corner, 1.5 / np.sqrt(2.0) * np.array([1.0, -1.0]))
