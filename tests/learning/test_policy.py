"""The best action, and ties."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.learning.policy import best_action, random_argmax


@functools.partial(jax.jit, static_argnames="ties")
def drawn(keys, scores, ties):
    """An action for each key."""
    return jax.vmap(lambda key: best_action(key, scores, ties))(keys)


def choices(scores, ties, draws=3000):
    keys = jax.random.split(jax.random.key(0), draws)
    return np.bincount(np.asarray(drawn(keys, np.asarray(scores), ties)), minlength=len(scores)) / draws


@pytest.mark.parametrize("ties", ["random", "first"])
@pytest.mark.parametrize("best", [0, 1, 2])
def test_the_best_action_is_taken(ties, best):
    scores = np.asarray([-1.0, -0.5, -2.0])
    scores[best] = 0.5
    assert choices(scores, ties)[best] == 1.0


def test_of_several_best_actions_the_first_or_all_equally_often_are_taken():
    assert choices([0.0, 1.0, 1.0, 1.0], "first")[1] == 1.0
    shares = choices([1.0, 0.0, 1.0, 1.0], "random")
    assert shares[1] == 0.0
    assert shares[[0, 2, 3]] == pytest.approx([1 / 3] * 3, abs=0.04)


chosen = jax.jit(random_argmax)


@pytest.mark.parametrize("num", [1, 2, 3, 6, 17, 1000])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_draws_span_the_best_actions_from_first_to_last(num, dtype):
    scores = np.tile(np.asarray([-1.0, 0.0], dtype), num)  # every second one is a best one
    least, greatest = np.zeros((), dtype), np.nextafter(np.ones((), dtype), np.zeros((), dtype))
    assert int(chosen(least, scores)) == 1
    assert int(chosen(greatest, scores)) == 2 * num - 1
