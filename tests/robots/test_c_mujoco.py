"""C MuJoCo under `Simulator`: threads, and lanes of which MuJoCo warns. `test_lanes` has its lanes."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bojax.robots import c_mujoco
from bojax.robots.c_mujoco import CSteps
from tests.robots.test_simulator import LANES, driven, reference, simulator


def given(name):
    """Rows of positions, velocities, a warm start and controls, of `LANES` lanes."""
    qpos, qvel, controls = driven(name)
    return np.concatenate([qpos, qvel, np.zeros_like(qvel), controls[:, 0]], axis=1)


def test_the_number_of_threads_changes_nothing(monkeypatch):
    steps, before = CSteps(reference("car"), 5), given("car")
    alone = steps._advance(before)
    with ThreadPoolExecutor(3) as pool:
        monkeypatch.setattr(c_mujoco, "_LANES_PER_THREAD", 1)
        monkeypatch.setattr(c_mujoco, "_threads", lambda: (pool, 3))
        np.testing.assert_array_equal(steps._advance(before), alone)
    assert len(alone) == LANES and np.isfinite(alone).all()


@pytest.mark.parametrize(
    ("part", "wrong"),
    [("qpos", np.nan), ("qpos", np.inf), ("qvel", np.nan), ("qvel", 1e12), ("control", np.nan)],
)
def test_a_lane_of_which_mujoco_warns_has_diverged_and_prints_nothing(part, wrong, here, capfd):
    before = given("hopper")
    alone = CSteps(reference("hopper"), 4)._advance(before)
    before[3, {"qpos": 1, "qvel": 6, "control": -1}[part]] = wrong
    after = CSteps(reference("hopper"), 4)._advance(before)
    others = np.arange(LANES) != 3
    np.testing.assert_array_equal(after[others], alone[others])
    assert np.isnan(after[3]).all()
    assert capfd.readouterr() == ("", "") and not list(here.iterdir())


def test_the_model_of_the_simulator_keeps_its_options():
    flags = simulator("hopper").mujoco_model.opt.disableflags
    CSteps(simulator("hopper").mujoco_model, 1)
    assert simulator("hopper").mujoco_model.opt.disableflags == flags
