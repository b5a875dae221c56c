"""The parts of the reference equal those of bojax, each alone."""

import equinox as eqx
import jax
import numpy as np
import pytest
from jaxtyping import Float

from bojax.models import kernels
from bojax.models.gaussian_process import GaussianProcess
from bojax.motions.base import place
from tests.planning.samples import ACQUISITIONS, f64, kernel_trajectories, parking, path_of
from tests.reference.bridge import reference_acquisition, reference_kernel, reference_problem
from tests.reference.kernel_trajectories import KernelTrajectory
from tests.reference.node_gp import NodeGP

PROBLEMS = {
    "as configured": parking(),
    "robot's bearing": parking(bearing="robot", success_needs_bearing=True),
    "exits end no episode": parking(exit_terminates=False),
    "ends of paths only": parking(park_along_path=False, success_needs_bearing=True),
}


def _starts(rng: np.random.Generator, num: int) -> Float[np.ndarray, "K 3"]:
    """Poses all over the domain, every second one before the lot and some outside the domain."""
    starts = rng.uniform([-4.0, -4.0, 0.0], [4.0, 4.0, 2.0 * np.pi], (num, 3))
    starts[::2] = np.array([-0.9, 0.0, 0.0]) + 0.1 * rng.normal(size=starts[::2].shape)
    starts[1::7, :2] *= 1.2
    return starts


@pytest.fixture(scope="module")
def drives():
    """Starts and paths."""
    rng = np.random.default_rng(0)
    starts = _starts(rng, 400)
    return starts, jax.jit(jax.vmap(kernel_trajectories().path))(f64(rng.uniform(-1.0, 1.0, (400, 3))))


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_paths_have_the_same_outcome(problem, drives):
    starts, paths = drives

    @jax.jit
    @jax.vmap
    def drive(start, path):
        poses = place(path, start)
        outcome = problem.outcome(start, poses)
        return outcome, poses[outcome.last]

    outcomes, ends = drive(f64(starts), paths)
    reference = reference_problem(problem)
    expected = [reference.drive(start, path) for start, path in zip(starts, np.asarray(paths), strict=True)]
    pose, reward, is_terminal = (np.array(part) for part in zip(*expected, strict=True))
    np.testing.assert_array_equal(outcomes.terminated, is_terminal)
    np.testing.assert_allclose(outcomes.reward, reward, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ends, pose, rtol=1e-12, atol=1e-12)
    assert {1000.0, -1000.0} <= set(reward)


@pytest.mark.parametrize("start", ["pose", "relaxed"])
def test_kernel_trajectories_follow_the_formulas(start):
    settings = {
        "first_angle": 0.3,
        "turn_angle": 1.0,
        "space_lengthscale": 0.5,
        "time_lengthscale": 0.7,
        "epsilon": 0.1,
        "delta": 1e-5,
    }
    motions = kernel_trajectories()
    motions = type(motions)(**{**vars(motions), "start": start})
    rng = np.random.default_rng(1)
    for params in rng.uniform(-1.0, 1.0, (8, 3)):
        expected = KernelTrajectory(params, start=start, **settings).path(length=1.0, num_samples=6)
        # The arc length here is a trapezoid rule over 65 knots, that of the reference 2000 chords.
        np.testing.assert_allclose(path_of(motions, f64(params)), expected, rtol=0.0, atol=2e-4)


@pytest.mark.parametrize("kernel", ["RBF", "Matern12", "Matern32", "Matern52"])
def test_the_node_gp_is_the_gaussian_process(kernel):
    rng = np.random.default_rng(2)
    xs, y, queries = rng.uniform(-1, 1, (7, 3)), rng.normal(size=7), rng.uniform(-1, 1, (20, 3))
    compiled = getattr(kernels, kernel)(f64([0.5, 0.7, 1.1]))
    model = GaussianProcess.prior(compiled, f64(0.01), capacity=9, num_dims=3)
    reference = NodeGP(reference_kernel(compiled), 0.01, capacity=9, num_dims=3)

    @eqx.filter_jit
    def observe(model, x, y):
        model = model.update(x, y)
        return model, model.predict(f64(queries))

    for i, x in enumerate(xs):
        model, moments = observe(model, f64(x), f64(y[i]))
        reference.append(x)
        expected = reference.predict(y[: i + 1], queries)
        for got, wanted in zip(moments, expected, strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ACQUISITIONS)
def test_acquisitions_agree(name):
    rng = np.random.default_rng(3)
    mean, std, best = rng.normal(size=200), rng.uniform(0.01, 2.0, 200), 0.7
    expected = reference_acquisition(ACQUISITIONS[name])(mean, std, best)
    np.testing.assert_allclose(
        ACQUISITIONS[name](f64(mean), f64(std), f64(best)), expected, rtol=1e-9, atol=1e-15
    )
