"""Where kernels of Pallas run; `tests/models/test_lookahead_kernels.py` tests kernels."""

import sys
import types

import jax
import jax.numpy as jnp
import pytest

from bojax.numerics.pallas import either, kernels_run_here


@pytest.mark.parametrize(
    ("device", "expected"),
    [
        ({"compute_capability": "8.0"}, True),
        ({"compute_capability": "10.3"}, True),
        ({"compute_capability": "7.5"}, False),
        ({"compute_capability": "gfx942"}, False),
        ({}, False),
    ],
)
def test_kernels_run_on_recent_nvidia_gpus(device, expected, monkeypatch):
    monkeypatch.setattr(jax, "devices", lambda: [types.SimpleNamespace(**device)])
    assert kernels_run_here() is expected


def test_a_jax_without_triton_has_no_kernels(monkeypatch):
    monkeypatch.setattr(jax, "devices", lambda: [types.SimpleNamespace(compute_capability="9.0")])
    monkeypatch.setitem(sys.modules, "jax.experimental.pallas.triton", None)
    assert not kernels_run_here()


@pytest.mark.parametrize("is_kernel", [True, False])
def test_only_a_gpu_computes_the_kernel(is_kernel):
    def compute(x):
        return either(is_kernel, lambda x: x + 1.0, lambda x: x - 1.0, x)

    expected = 1.0 if is_kernel and jax.default_backend() == "gpu" else -1.0
    assert jax.jit(jax.vmap(compute))(jnp.zeros(2)).tolist() == [expected, expected]
