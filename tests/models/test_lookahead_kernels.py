"""Kernels of the look-ahead, which a CPU interprets, against NumPy and the programs of XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.models import lookahead, lookahead_kernels
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52
from bojax.models.lookahead import LookaheadRoot, look_ahead
from tests.compiling import as_for_a_gpu

NUM_STAGES, SIZE, NUM_ROWS = 3, 2, 70
NUM_POINTS = NUM_STAGES * SIZE
COUNTS = np.asarray([0, 1, 32, 33, 70], np.int32)


@pytest.fixture
def factors():
    """Lower triangular matrices, zero past the number of observations."""
    is_held = np.arange(NUM_ROWS) < COUNTS[:, None]
    full = np.random.default_rng(0).normal(size=(len(COUNTS), NUM_ROWS, NUM_ROWS))
    return np.tril(full) * is_held[:, :, None] * is_held[:, None, :]


def test_products_with_the_factor_are_those_of_numpy(factors):
    rng = np.random.default_rng(1)
    right, left = rng.normal(size=(len(COUNTS), NUM_ROWS, 5)), rng.normal(size=(len(COUNTS), 3, NUM_ROWS))
    whitened = jax.jit(jax.vmap(lookahead_kernels.whitened))(factors, right, COUNTS)
    np.testing.assert_allclose(whitened, factors @ right, rtol=0, atol=1e-12)
    rows = jax.jit(jax.vmap(lookahead_kernels.explained_away))(left, factors, COUNTS)
    np.testing.assert_allclose(rows, left @ factors, rtol=0, atol=1e-12)


def test_kernels_are_lowered_for_a_gpu(factors, monkeypatch):
    """Triton's programs are made on any machine, and compiled on a GPU."""
    right, left = np.ones((len(COUNTS), NUM_ROWS, 5)), np.ones((len(COUNTS), 3, NUM_ROWS))
    joint, least = np.ones((4, NUM_POINTS, NUM_POINTS)), np.ones((4, NUM_POINTS))

    def all_of_them(factors, right, left, counts, joint, least):
        conditioned = jax.vmap(lambda *args: lookahead_kernels.conditioned(*args, NUM_STAGES, True))
        return (
            jax.vmap(lookahead_kernels.whitened)(factors, right, counts),
            jax.vmap(lookahead_kernels.explained_away)(left, factors, counts),
            conditioned(joint, least, least[:, :-SIZE]),
        )

    with as_for_a_gpu(monkeypatch):
        traced = jax.jit(all_of_them).trace(factors, right, left, COUNTS, joint, least)
        text = traced.lower(lowering_platforms=("cuda",)).as_text()
    for name in ("whitened", "explained_away", "conditioned"):
        assert f'"{name}"' in text


@pytest.mark.parametrize("with_weights", [True, False])
def test_conditioning_is_that_of_xla(with_weights):
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, NUM_POINTS, 2 * NUM_POINTS))
    least = rng.uniform(0.1, 0.2, (4, NUM_POINTS))
    joint = root @ root.swapaxes(1, 2) + least[:, :, None] * np.eye(NUM_POINTS)
    joint[1, 2, 2] = 0.0  # not positive definite: the pivot is raised
    innovations = rng.normal(size=(4, NUM_POINTS - SIZE))

    def computed(form):
        program = jax.jit(jax.vmap(lambda *args: form(*args, NUM_STAGES, with_weights)))
        return jax.tree.leaves(program(joint, least, innovations))

    found, expected = computed(lookahead_kernels.conditioned), computed(lookahead.conditioned)
    assert len(found) == 2 + with_weights
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)


def test_beliefs_by_kernels_are_those_of_xla(monkeypatch):
    rng = np.random.default_rng(3)
    kernel = Matern52(jnp.asarray(0.5, jnp.float64))
    x, noise = rng.uniform(size=(40, 2)), jnp.asarray(0.01, jnp.float64)
    posterior = GaussianProcess.fit(kernel, noise, x, np.sin(x.sum(1)), capacity=48)
    points = rng.uniform(size=(2, NUM_POINTS, 2))
    is_observed = np.asarray([[True] * 6, [True, False, True, True, False, True]])
    innovations = rng.normal(size=(2, NUM_POINTS))

    def beliefs():
        def lane(points, is_observed, innovations):
            root = LookaheadRoot.of(posterior)
            return look_ahead(root, points, is_observed, innovations, NUM_STAGES, with_gradient=True)

        return jax.jit(jax.vmap(lane))(points, is_observed, innovations)

    expected, used = beliefs(), []

    def kernel_of(is_used, by_kernel, by_xla, *args):
        used.append(is_used)
        return by_kernel(*args)

    monkeypatch.setattr(lookahead, "either", kernel_of)
    found = beliefs()
    assert len(used) == 3
    for got, wanted in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        at = is_observed.reshape(*is_observed.shape, *[1] * (wanted.ndim - 2))
        np.testing.assert_allclose(np.where(at, got, 0.0), np.where(at, wanted, 0.0), rtol=0, atol=1e-11)


def test_kernels_are_used_where_they_have_been_timed(monkeypatch):
    monkeypatch.setattr(lookahead_kernels, "kernels_run_here", lambda: True)
    assert lookahead_kernels.are_used(24, 16, jnp.float64)
    assert not lookahead_kernels.are_used(24, 16, jnp.float32)
    assert not lookahead_kernels.are_used(30, 20, jnp.float64)
    assert not lookahead_kernels.are_used(8, 0, jnp.float64)
