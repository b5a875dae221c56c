"""Where kernels of Pallas run; `tests/models/test_lookahead_kernels.py` tests kernels."""

import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.pallas import either, fused_product, kernels_run_here, launch


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


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_fused_product_is_rounded_once(dtype):
    def kernel(x, y, z, found):
        found[0] = fused_product(x[0], y[0], z[0])
        found[1] = fused_product(x[0], jnp.full((), 1.0 + small, dtype), z[0])

    # (1 + e)^2 - 1 - 2 e is e^2, which is lost where the product is rounded
    small = np.finfo(dtype).eps
    x, z = np.asarray([1 + small], dtype), np.asarray([-1 - 2 * small], dtype)
    (found,) = jax.jit(lambda *xs: launch(kernel, [jax.ShapeDtypeStruct((2,), dtype)], *xs, name="fused"))(
        x, x, z
    )
    expected = 0.0 if jax.default_backend() == "cpu" else small**2
    assert found.tolist() == [expected, expected]
