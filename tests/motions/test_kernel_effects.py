"""Effects of the kernels of kernel trajectories, against differences of a NumPy reference."""

import jax
import numpy as np
import pytest

from bojax.motions.kernel_effects import NUM_INTERVALS, kernel_effects
from tests.motions.families import NUM_SAMPLES, kernel
from tests.reference.kernel_trajectories import KernelTrajectory

TIMES = (np.arange(NUM_INTERVALS) + 0.5) / NUM_INTERVALS
STEP = 1e-4


def profile(params, space: float, time: float, start: str) -> dict[str, np.ndarray]:
    """Speed, its rate of change by central differences, and turns between poses at equal lengths."""
    trajectory = KernelTrajectory(params, 0.3, 1.0, space, time, epsilon=0.1, delta=1e-5, start=start)

    def speed(times):
        return np.linalg.norm(trajectory.velocity(times), axis=1)

    speeds = speed(TIMES)
    accelerations = (speed(TIMES + STEP) - speed(TIMES - STEP)) / (2.0 * STEP)
    turns = np.diff(np.unwrap(trajectory.path(1.0, NUM_SAMPLES)[:, 2])) * NUM_SAMPLES
    return {
        "speed": speeds / speeds.mean(),
        "acceleration": accelerations / speeds.mean(),
        "turns": turns,
    }


@pytest.mark.parametrize("start", ["pose", "relaxed"])
def test_effects_are_changes_by_half_a_lengthscale(start):
    motions = kernel(start=start)
    effects = jax.jit(kernel_effects)
    for params in np.random.default_rng(1).uniform(-1.0, 1.0, (4, 3)):
        before = profile(params, 0.5, 0.7, start)
        by_time, by_space = profile(params, 0.5, 0.35, start), profile(params, 0.25, 0.7, start)

        def ratio(name, above, below, before=before):
            return np.log(
                np.linalg.norm(above[name] - before[name]) / np.linalg.norm(below[name] - before[name])
            )

        found = effects(motions, jax.numpy.asarray(params))
        expected = {
            "speed_by_time": ratio("speed", by_time, by_space),
            "acceleration_by_time": ratio("acceleration", by_time, by_space),
            "turns_by_space": ratio("turns", by_space, by_time),
        }
        assert set(found) == set(expected)
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, atol=5e-3, err_msg=name)


def test_a_kernel_without_effect_has_no_ratio():
    straight = jax.jit(kernel_effects)(kernel(start="pose"), jax.numpy.zeros(3))
    assert np.isnan(straight["turns_by_space"])
