"""The point among walls: its moves beside a plain version, and that every layout can be solved."""

from collections import deque

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.point_maze import GOALS, WALLS
from bojax.envs.settings import PointMaze

LAYOUTS = ["open", "wall", "maze", "rooms"]


def moved(layout, position, move):
    """Along x, then along y; a part that ends inside a wall or outside of the square is not made."""
    x, y = position

    def is_free(x, y):
        inside = any(a <= x <= c and b <= y <= d for a, b, c, d in WALLS[layout])
        return 0 <= x <= 1 and 0 <= y <= 1 and not inside

    if is_free(x + move[0], y):
        x = x + move[0]
    if is_free(x, y + move[1]):
        y = y + move[1]
    return x, y


@eqx.filter_jit
def step(env, states, actions):
    return jax.vmap(lambda s, a: env.step(jax.random.key(0), s, a))(states, actions)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_move_is_that_of_the_plain_version(layout):
    env, rng = build(PointMaze(layout=layout)), np.random.default_rng(0)
    states, actions = rng.uniform(size=(500, 2)), rng.uniform(-1.5, 1.5, size=(500, 2))
    after, made = step(env, jnp.asarray(states), jnp.asarray(actions))
    expected = [moved(layout, s, 0.05 * np.clip(a, -1, 1)) for s, a in zip(states, actions, strict=True)]
    np.testing.assert_allclose(after, expected, atol=1e-12)
    is_goal = np.linalg.norm(np.asarray(expected) - GOALS[layout], axis=1) <= 0.1
    np.testing.assert_array_equal(made.success, is_goal)
    np.testing.assert_array_equal(made.reward, is_goal)
    np.testing.assert_array_equal(made.terminated, is_goal)
    assert 0 < is_goal.sum() < 100


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_goal_is_reached_in_time_by_the_shortest_path(layout):
    """A breadth-first search on a grid of longest moves, with the plain version."""
    start, moves = (0.125, 0.125), [(0.05, 0), (-0.05, 0), (0, 0.05), (0, -0.05)]
    position, distance, queue = start, {start: 0}, deque([start])
    while queue:
        position = queue.popleft()
        if np.linalg.norm(np.subtract(position, GOALS[layout])) <= 0.1:
            break
        for move in moves:
            after = tuple(np.round(moved(layout, position, move), 6))
            if after not in distance:
                distance[after] = distance[position] + 1
                queue.append(after)
    assert 25 < distance[position] < 0.6 * PointMaze().max_steps
    straight = np.abs(np.subtract(GOALS[layout], start)).sum() / 0.05
    # Walls are in the way; the doors of the rooms are passed without a detour.
    assert (distance[position] > straight + 5) == (layout in ("wall", "maze"))


def test_an_episode_begins_in_the_corner():
    states = jax.vmap(build(PointMaze()).reset)(jax.random.split(jax.random.key(0), 200))
    assert np.all((np.asarray(states) >= 0.05) & (np.asarray(states) <= 0.15))
