"""The programs that JAX makes of kernels for a GPU, interpreted, against JAX."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.numerics.pallas import launch
from bojax.numerics.third_party import standard_jax
from bojax.robots.kernel.scalars import ScalarProgram
from bojax.robots.newton import search_at_ends
from bojax.robots.simulator import ConfiguredModel, RobotState, _kernel_steps, _steps_of
from tests.robots.kernel.test_scalar_kernel import MODELS, SUBSTEPS, driven
from tests.tiers import by_tier
from tests.triton import interpreted


def draws(words, x):
    keys = jax.random.split(jax.random.wrap_key_data(words), 7)
    return (
        jax.random.bits(keys[0], (2,), jnp.uint32),
        jax.random.uniform(keys[1], (2,), x.dtype),
        jax.random.randint(keys[2], (2,), 0, 7, jnp.int32),
        jax.random.choice(keys[3], 3, p=jnp.asarray([0.2, 0.3, 0.5], x.dtype)),
        jax.random.normal(keys[4], (4,), jnp.float32),
        jax.random.exponential(keys[5], (2,), x.dtype),
        jax.random.key_data(jax.random.fold_in(keys[6], (10.0 * x[0]).astype(jnp.int32))),
        jnp.log1p(x),
        jax.lax.erf_inv(x.astype(jnp.float32)),
    )


def test_draws(monkeypatch):
    words, xs = (
        np.random.default_rng(0).integers(0, 2**32, (4, 2)).astype(np.uint32),
        np.array([[-0.9], [0.3]]),
    )
    examples = words[0], xs[0]
    program = ScalarProgram(draws, *examples, keeps_nan=True)
    shapes = [
        jax.ShapeDtypeStruct((x.size,), x.dtype) for x in jax.tree.leaves(jax.eval_shape(draws, *examples))
    ]

    def body(words, x, *refs):
        values = iter(program([words[0], words[1], x[0]]))
        for ref in refs:
            for i in range(ref.shape[0]):
                ref[i] = next(values)

    kernel = interpreted(monkeypatch, lambda *given: launch(body, shapes, *given, name="draws"), *examples)
    expected = jax.jit(draws)
    for given in itertools.product(words, xs):
        for ours, theirs in zip(kernel(*given), expected(*given), strict=True):
            rounding = 1e-6 if ours.dtype == np.float32 else 1e-12
            np.testing.assert_allclose(ours, np.ravel(theirs), rtol=rounding, atol=rounding)


@pytest.mark.parametrize("name", by_tier(["pendulum", "hopper"], normal=["pendulum"]))
def test_steps_of_a_robot(monkeypatch, name):
    qpos, qvel, controls = driven(name)
    steps = _kernel_steps(ConfiguredModel(MODELS[name]), SUBSTEPS)
    expected = jax.jit(_steps_of(ConfiguredModel(MODELS[name]), SUBSTEPS, search_at_ends))

    lanes = [*zip(qpos, qvel, 0.0 * qvel, controls[0], strict=True)]

    @standard_jax
    def advance(qpos, qvel, start, control):
        return steps(RobotState(qpos, qvel, start), control)

    kernel = interpreted(monkeypatch, advance, *lanes[0])
    for given in lanes:
        found = kernel(*given)
        after = expected(RobotState(*given[:3]), given[3])
        np.testing.assert_allclose(found[0], after.qpos, atol=1e-5)
        np.testing.assert_allclose(found[1], after.qvel, rtol=1e-4, atol=1e-4)
