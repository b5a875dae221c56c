"""Functions of the engine's batch axis, inside the batch and outside."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.lanes import LANES, any_lane, batched_together, lane_by_lane_on_cpu

FLAGS = [[False, False, False], [False, True, False], [True, True, True]]


@pytest.mark.parametrize("flags", FLAGS)
def test_every_lane_sees_whether_any_flag_holds(flags):
    # `out_axes=None` refuses a value that may differ between lanes.
    seen = jax.vmap(any_lane, axis_name=LANES, out_axes=None)(jnp.asarray(flags))
    assert bool(seen) == any(flags)


def test_a_single_lane_sees_its_own_flag():
    for flag in (False, True):
        assert bool(any_lane(jnp.asarray(flag))) == flag


def test_other_batch_axes_stay_apart():
    flags = jnp.asarray(FLAGS)
    np.testing.assert_array_equal(jax.vmap(any_lane)(flags[:, 1]), flags[:, 1])
    over_lanes = jax.vmap(jax.vmap(any_lane), axis_name=LANES)(flags.T)
    np.testing.assert_array_equal(over_lanes, np.broadcast_to(np.any(FLAGS, axis=1), (3, 3)))


def test_a_loop_runs_until_the_slowest_lane_is_done():
    def countdown(length):
        def step(carry):
            left, turns = carry
            return jnp.maximum(left - 1, 0), turns + 1

        return jax.lax.while_loop(lambda c: any_lane(c[0] > 0), step, (length, jnp.zeros_like(length)))

    left, turns = jax.vmap(countdown, axis_name=LANES)(jnp.asarray([1, 5, 3]))
    np.testing.assert_array_equal(left, [0, 0, 0])
    np.testing.assert_array_equal(turns, [5, 5, 5])


def test_the_predicate_of_a_loop_is_not_batched():
    def count(limit):
        return jax.lax.while_loop(
            lambda n: any_lane(n < limit), lambda n: n + (n < limit).astype(n.dtype), jnp.zeros_like(limit)
        )

    limits = jnp.arange(5)
    batched = jax.vmap(count, axis_name=LANES)
    np.testing.assert_array_equal(batched(limits), limits)
    (loop,) = [eqn for eqn in jax.make_jaxpr(batched)(limits).eqns if eqn.primitive.name == "while"]
    assert loop.params["cond_jaxpr"].out_avals[0].shape == ()


def test_initial_values_are_batched_together():
    together = jax.vmap(lambda x: batched_together((x, {"zero": jnp.zeros(2)})), axis_name=LANES)
    x, rest = together(jnp.arange(3.0))
    np.testing.assert_array_equal(x, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(rest["zero"], np.zeros((3, 2)))
    # `out_axes=None` refuses what is batched.
    with pytest.raises(ValueError, match="out_axes"):
        jax.vmap(lambda x: batched_together((x, jnp.zeros(2)))[1], out_axes=None)(jnp.arange(3.0))
    alone = jax.vmap(lambda x: batched_together((jnp.ones(()), jnp.zeros(2))), out_axes=None)(jnp.arange(3.0))
    np.testing.assert_array_equal(alone[0], 1.0)


def test_values_that_are_batched_together_have_gradients():
    def last(x):
        start = batched_together((x, jnp.ones(()), jnp.zeros((), jnp.int32)))
        return jax.lax.fori_loop(0, 3, lambda _, loop: (loop[0], loop[0] * loop[1], loop[2] + 1), start)[1]

    x = jnp.asarray([1.0, 2.0, -3.0])
    for gradient in (jax.grad(last), jax.jacfwd(last)):
        np.testing.assert_allclose(jax.jit(jax.vmap(gradient))(x), 3 * x**2, rtol=1e-6)


def test_the_body_of_a_loop_is_batched_fewer_times():
    batchings = Counter()

    def batched(start, name):
        @jax.custom_batching.custom_vmap
        def noted(x):
            return x

        @noted.def_vmap
        def _(_, is_batched, x):
            batchings[name] += 1
            return x, is_batched[0]

        def chain(x):  # x is passed on from one value to the next: a batching reveals one more of them
            def step(values, _):
                a, b, c = values
                return (noted(x), a, b), None

            return jax.lax.scan(step, start((0.0 * jnp.ones(()), jnp.zeros(()), jnp.zeros(()), x)), length=5)[
                0
            ]

        return jax.jit(jax.vmap(chain)).lower(jnp.arange(3.0))

    apart = batched(lambda values: values[:3], "apart")
    together = batched(lambda values: batched_together(values)[:3], "together")
    assert batchings == {"apart": 4, "together": 1}
    assert sorted(_operations(apart)) == sorted(_operations(together))


def _halvings(start, offset):
    """Halve a number until it is at most 1, and count the iterations of the loop."""

    def step(loop):
        x, count = loop
        return jnp.where(x > 1.0, x / 2.0, x), count + 1

    x, count = jax.lax.while_loop(
        lambda loop: any_lane(loop[0] > 1.0), step, (start, jnp.zeros((), jnp.int32))
    )
    return {"x": x + offset, "count": count}


def test_a_constant_may_be_an_array_of_numpy():
    compute = jax.vmap(lambda x: lane_by_lane_on_cpu(_halvings, x, np.zeros((), np.float32)), axis_name=LANES)
    np.testing.assert_array_equal(compute(np.asarray([3.0, 5.0], np.float32))["x"], [0.75, 0.625])


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_a_cpu_computes_lane_by_lane(backend, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    x, offset = jnp.asarray([0.5, 8.0, 64.0, 2.0]), jnp.asarray(3.0)
    compute = jax.vmap(
        lambda x, offset: lane_by_lane_on_cpu(_halvings, x, offset), (0, None), axis_name=LANES
    )
    found = jax.jit(compute)(x, offset)
    np.testing.assert_array_equal(found["x"], [3.5, 4.0, 4.0, 4.0])
    # In a batch, every lane takes part until the last one ends.
    np.testing.assert_array_equal(found["count"], [0, 3, 6, 1] if backend == "cpu" else [6, 6, 6, 6])
    alone = jax.jit(lambda x: lane_by_lane_on_cpu(_halvings, x, offset))(x[1])
    assert (float(alone["x"]), int(alone["count"])) == (4.0, 3)


def _operations(lowered):
    return [line.split(" = ")[1].split()[0] for line in lowered.as_text().splitlines() if " = " in line]
