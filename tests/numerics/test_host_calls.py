"""Calls of NumPy functions by name: their results, exceptions, and programs from JAX's cache."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from bojax.numerics.host_calls import call, register


def halved(rows):
    """Half of the first two columns of some rows."""
    if (rows < 0.0).any():
        raise ValueError("negative")
    return 0.5 * rows[:, :2]


@pytest.fixture(scope="module", autouse=True)
def _registered():
    if jax.default_backend() != "cpu":
        pytest.skip("host calls are handlers of the CPU")
    assert register("bojax_test_halved", halved)
    assert register("bojax_test_halved", halved)


@jax.jit
def many(rows):
    """Four calls, each with the results of the one before."""
    return jax.lax.fori_loop(
        0, 4, lambda i, x: jnp.pad(call("bojax_test_halved", x, 2), ((0, 0), (0, 1))), rows
    )


def test_calls_in_a_loop():
    rows = np.random.default_rng(0).uniform(size=(5, 3)).astype(np.float32)
    np.testing.assert_array_equal(many(rows)[:, :2], rows[:, :2] / 16.0)
    np.testing.assert_array_equal(many(rows)[:, 2], 0.0)


def test_an_exception_is_printed_and_gives_nan(capfd):
    result = jax.jit(lambda x: call("bojax_test_halved", x, 2))(-jnp.ones((2, 3), jnp.float32))
    assert np.isnan(result).all()
    assert "ValueError: negative" in capfd.readouterr().err


def test_programs_come_from_the_cache(tmp_path):
    events = []
    jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
    settings = {
        "jax_compilation_cache_dir": str(tmp_path),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    rows = np.ones((7, 3), np.float32)
    try:
        compilation_cache.reset_cache()
        for name, value in settings.items():
            jax.config.update(name, value)
        for found in ("/jax/compilation_cache/cache_misses", "/jax/compilation_cache/cache_hits"):
            jax.clear_caches()
            events.clear()
            np.testing.assert_array_equal(many(rows)[:, :2], rows[:, :2] / 16.0)
            assert found in events
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()
