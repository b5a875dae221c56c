"""Third-party code is traced without 64-bit numbers and strict promotion."""

import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.third_party import silenced, standard_jax


def theirs(key, x, n):
    """Promotes types and ranks, and uses a raw key twice."""
    noise = jax.random.normal(key, (3,)) + jax.random.normal(key, (2, 3))
    return {"x": x * n + noise, "zero": 0.0, "count": n + jnp.arange(2), "size": jnp.zeros(4).shape[0]}


def test_what_it_traces_is_a_32_bit_program():
    with pytest.raises(ValueError):  # the settings of these tests: strict
        jax.jit(theirs)(jax.random.key_data(jax.random.key(0)), jnp.ones(3), jnp.asarray(2))
    found = jax.jit(standard_jax(theirs))(jax.random.key(0), jnp.ones(3), jnp.asarray(2))
    assert {name: x.dtype.name for name, x in found.items()} == {
        "x": "float32",
        "zero": "float32",
        "count": "int32",
        "size": "int32",
    }
    assert not any(x.weak_type for x in jax.tree.leaves(found))
    program = jax.make_jaxpr(standard_jax(theirs))(jax.random.key(0), jnp.ones(3), jnp.asarray(2))
    computed = [v.aval.dtype.name for e in program.eqns for v in e.outvars]
    assert not any("64" in name for name in computed)


def test_it_computes_the_same_alone_and_within_a_vmapped_loop():
    ours = standard_jax(lambda x: jnp.sin(x) * 3)

    def loop(x):
        return jax.lax.fori_loop(0, 4, lambda _, y: ours(y).astype(x.dtype), x)

    batch = jnp.linspace(0.0, 1.0, 5)
    assert batch.dtype == jnp.float64
    expected = np.asarray(batch)
    for _ in range(4):
        expected = 3 * np.sin(expected)
    np.testing.assert_allclose(jax.jit(jax.vmap(loop))(batch), expected, rtol=1e-5)
    assert jnp.ones(2).dtype == jnp.float64  # and nothing is left switched off


def test_silence(capsys):
    with silenced():
        print("something about warp")
        print("more", file=sys.stderr)
        warnings.warn("unmaintained", stacklevel=1)
    print("heard")
    assert capsys.readouterr() == ("heard\n", "")
