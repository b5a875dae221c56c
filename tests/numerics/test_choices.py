"""Choices as array leaves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.choices import Choice, one_of


class Sign(eqx.Module):
    direction: Choice = eqx.field(converter=one_of("up", "down"))

    def __call__(self, x):
        return jnp.where(self.direction.is_("up"), x, -x)


def test_modules_that_differ_in_a_choice_are_one_program():
    up, down = Sign("up"), Sign("down")
    assert jax.tree.structure(up) == jax.tree.structure(down)
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), up, down)
    np.testing.assert_array_equal(jax.vmap(lambda sign: sign(2.0))(both), [2.0, -2.0])


def test_a_choice_stays_when_a_module_is_made_from_another():
    assert bool(Sign(Sign("down").direction).direction.is_("down"))


def test_other_names_are_refused():
    with pytest.raises(ValueError, match='^got "left"; allowed: up, down$'):
        Sign("left")
    with pytest.raises(ValueError):
        Sign("up").direction.is_("left")
