"""Steps as a kernel, interpreted on a CPU, against XLA's program; `test_simulator` runs kernels on a GPU."""

import functools

import jax
import numpy as np
import pytest

import bojax.robots.simulator
from bojax.engine.build import build
from bojax.numerics.disk_cache import KERNELS
from bojax.numerics.third_party import standard_jax
from bojax.robots.kernel import scalar_kernel
from bojax.robots.models import RobotModel, packaged
from bojax.robots.newton import search_at_ends
from bojax.robots.settings import MJX
from bojax.robots.simulator import (
    ConfiguredModel,
    RobotState,
    Simulator,
    _can_be_a_kernel,
    _compiled,
    _kernel_steps,
    _steps_of,
)
from tests.compiling import as_for_a_gpu
from tests.engine.test_program_cache import caching_in
from tests.robots import test_simulator
from tests.tiers import by_tier

LANES, STEPS, SUBSTEPS = 6, 5, 3

PENDULUM = RobotModel(
    """<mujoco>
      <option timestep="0.01" integrator="RK4" iterations="4"/>
      <worldbody>
        <geom name="floor" type="plane" size="1 1 1" condim="1"/>
        <body pos="0 0 0.3">
          <joint name="swing" type="hinge" axis="0 1 0" limited="true" range="-40 40" frictionloss="0.02"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.03" contype="0" conaffinity="0"/>
          <body pos="0 0 -0.25">
            <joint name="slide" type="slide" axis="0 0 1" damping="0.1"/>
            <geom type="sphere" size="0.06" condim="1"/>
          </body>
        </body>
      </worldbody>
      <actuator><motor joint="swing" ctrllimited="true" ctrlrange="-1 1"/></actuator>
    </mujoco>"""
)
"""A pendulum whose end slides, touches the floor, and has friction and limits: every kind of constraint."""

MODELS = {"pendulum": PENDULUM} | {
    name: packaged(name) for name in ("hopper", "reacher", "jaco", "quadrotor")
}


@functools.cache
def steps(name):
    return _kernel_steps(ConfiguredModel(MODELS[name]), SUBSTEPS)


def driven(name):
    """Random states and controls."""
    model, rng = _compiled(ConfiguredModel(MODELS[name])), np.random.default_rng(0)
    low, high = model.actuator_ctrlrange.T
    qpos = model.qpos0 + rng.uniform(-0.3, 0.3, (LANES, model.nq))
    arrays = qpos, rng.normal(size=(LANES, model.nv)), rng.uniform(low, high, (STEPS, LANES, model.nu))
    return [array.astype(np.float32) for array in arrays]


def scanned(advance, qpos, qvel, controls):
    def lane(qpos, qvel, controls):
        start = RobotState(qpos, qvel, 0.0 * qvel)
        return jax.lax.scan(lambda state, control: (advance(state, control), None), start, controls)[0]

    return jax.jit(jax.vmap(lane, in_axes=(0, 0, 1)))(qpos, qvel, controls)


@pytest.mark.parametrize("name", by_tier(MODELS, normal=["pendulum"]))
def test_a_kernel_is_xlas_program(name):
    arrays = driven(name)
    found = scanned(standard_jax(steps(name)), *arrays)
    expected = scanned(_steps_of(ConfiguredModel(MODELS[name]), SUBSTEPS, search_at_ends), *arrays)
    np.testing.assert_allclose(found.qpos, expected.qpos, atol=1e-5)
    np.testing.assert_allclose(found.qvel, expected.qvel, rtol=1e-3, atol=1e-3)
    assert np.abs(found.qpos - arrays[0]).max() > 1e-2


@pytest.mark.parametrize("name", by_tier(["jaco", "quadrotor"], normal=["quadrotor"]))
def test_a_kernel_is_c_mujoco(name):
    """After one step and after twenty; `test_simulator` compares XLA's program in the same way."""
    advance = standard_jax(_kernel_steps(ConfiguredModel(test_simulator.MODELS[name]), 1))

    def lane(qpos, qvel, controls):
        def step(state, control):
            state = advance(state, control)
            return state, (state.qpos, state.qvel)

        return jax.lax.scan(step, RobotState(qpos, qvel, 0.0 * qvel), controls)[1]

    arrays = test_simulator.driven(name)
    places, speeds = jax.jit(jax.vmap(lane))(*arrays)
    model = test_simulator.reference(name)
    expected = [test_simulator.steps_of(model, *lane) for lane in zip(*arrays, strict=True)]
    expected_places, expected_speeds = (np.array(part) for part in zip(*expected, strict=True))
    np.testing.assert_allclose(places[:, 0], expected_places[:, 0], rtol=2e-7, atol=1e-6)
    np.testing.assert_allclose(speeds[:, 0], expected_speeds[:, 0], rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(places, expected_places, atol=1e-5)
    np.testing.assert_allclose(speeds, expected_speeds, rtol=1e-5, atol=1e-4)
    assert np.abs(expected_places[:, -1] - arrays[0]).max() > 1e-2


def test_a_model_that_is_too_large_is_refused(monkeypatch):
    steps("pendulum")  # kept, so that the limit does not apply to it
    monkeypatch.setattr(scalar_kernel, "MOST_SCALARS", 100)
    with pytest.raises(
        ValueError, match='got "pallas"; a kernel cannot simulate the model .too many scalars'
    ):
        _kernel_steps(ConfiguredModel(PENDULUM), SUBSTEPS + 1)
    assert not _can_be_a_kernel(ConfiguredModel(PENDULUM), SUBSTEPS + 1)
    assert _can_be_a_kernel(ConfiguredModel(PENDULUM), SUBSTEPS)


def test_whether_a_model_can_be_a_kernel_is_kept(monkeypatch, tmp_path):
    """A process that finds the answer traces nothing, and builds the kernel once a program needs it."""
    made = []
    monkeypatch.setattr(bojax.robots.simulator, "kernels_run_here", lambda: True)
    monkeypatch.setattr(bojax.robots.simulator, "_kernel_steps", lambda *key: made.append(key))

    def simulator():
        _can_be_a_kernel.cache_clear()  # as in a new process
        return Simulator(build(MJX(impl="pallas"), "float32"), PENDULUM, substeps=1)

    with caching_in(tmp_path / "cache"):
        simulator()
        assert len(made) == 1
        assert simulator().impl == "pallas"
        assert len(made) == 1
        (entry,) = (tmp_path / "cache" / KERNELS).iterdir()
        entry.write_bytes(b"yes")  # without a checksum
        simulator()
        assert len(made) == 2
        monkeypatch.setattr(scalar_kernel, "MOST_SCALARS", 100)  # another kernel
        simulator()
        assert len(made) == 3
    _can_be_a_kernel.cache_clear()


def test_a_kernel_needs_a_gpu(monkeypatch):
    monkeypatch.setattr(bojax.robots.simulator, "kernels_run_here", lambda: False)
    with pytest.raises(ValueError, match='got "pallas", which needs an NVIDIA GPU'):
        Simulator(build(MJX(impl="pallas"), "float32"), PENDULUM, substeps=1)


def test_kernels_are_lowered_for_a_gpu(monkeypatch):
    """Triton's program is made on any machine, and compiled on a GPU."""
    qpos, qvel, control = (jax.ShapeDtypeStruct((LANES, size), np.float32) for size in (2, 2, 1))
    state = jax.eval_shape(jax.vmap(RobotState), qpos, qvel, qvel)
    with as_for_a_gpu(monkeypatch):
        traced = jax.jit(jax.vmap(standard_jax(steps("pendulum")))).trace(state, control)
        assert "triton" in traced.lower(lowering_platforms=("cuda",)).as_text()
