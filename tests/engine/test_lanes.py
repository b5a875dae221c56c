"""`any_lane` looks across the lanes of a batch, and at its own flag outside one."""

import jax
import jax.numpy as jnp

from bojax.numerics.lanes import LANES, any_lane


def test_outside_a_batch():
    assert any_lane(jnp.asarray(True)) and not any_lane(jnp.asarray(False))


def test_in_a_batch():
    flags = jnp.asarray([False, True, False])
    assert jax.vmap(any_lane, axis_name=LANES)(flags).tolist() == [True] * 3


def test_a_loop_that_ends_on_it_keeps_one_predicate():
    def count(limit):
        return jax.lax.while_loop(
            lambda n: any_lane(n < limit), lambda n: n + (n < limit).astype(n.dtype), jnp.zeros_like(limit)
        )

    limits = jnp.arange(5)
    batched = jax.vmap(count, axis_name=LANES)
    assert batched(limits).tolist() == limits.tolist()
    (loop,) = [eqn for eqn in jax.make_jaxpr(batched)(limits).eqns if eqn.primitive.name == "while"]
    assert loop.params["cond_jaxpr"].out_avals[0].shape == ()
