"""argmax Q + kappa U, and its ties."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.learning.policy import best_action, random_argmax


@functools.partial(jax.jit, static_argnames="ties")
def drawn(keys, q, u, kappa, ties):
    """An action for each key."""
    return jax.vmap(lambda key: best_action(key, q, u, kappa, ties))(keys)


def choices(q, u, kappa, ties, draws=3000):
    keys = jax.random.split(jax.random.key(0), draws)
    actions = drawn(keys, np.asarray(q), np.asarray(u), np.asarray(kappa), ties)
    return np.bincount(np.asarray(actions), minlength=len(q)) / draws


@pytest.mark.parametrize("ties", ["random", "first"])
@pytest.mark.parametrize("kappa, best", [(0.0, 2), (1.0, 0), (20.0, 1)])
def test_kappa_weighs_exploration_against_exploitation(ties, kappa, best):
    shares = choices([1.0, 0.0, 2.0], [-1.0, -0.9, -3.0], kappa, ties)
    assert shares[best] == 1.0


def test_the_first_of_several_best_actions_is_taken_where_that_is_asked_for():
    assert choices([0.0, 1.0, 1.0, 1.0], [0.0] * 4, 1.0, "first")[1] == 1.0


def test_all_best_actions_are_equally_likely_and_no_other_is_taken():
    shares = choices([1.0, 0.0, 1.0, 1.0], [0.0] * 4, 1.0, "random")
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
