"""Constrained accelerations: the gradient of MuJoCo's cost, which is strictly convex, is zero."""

import functools
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from bojax.robots.models import RobotModel
from bojax.robots.newton import constrained, has_clipped_forces, search_at_ends, search_by_points

EQUALITIES, SLIDERS, LIMITS = 2, 4, 7
ROWS = EQUALITIES + SLIDERS + LIMITS
LANES = 64


def problems(size, dtype, seed=0):
    """Inertias, rows and starts of `LANES` problems; limits that are not active have zero rows, as in MJX."""
    rng = np.random.default_rng(seed)
    draws = rng.normal(size=(LANES, size, 2 * size))
    inertia = draws @ draws.swapaxes(1, 2) / size + 0.1 * np.eye(size)
    jacobian, target = rng.normal(size=(LANES, ROWS, size)), rng.normal(size=(LANES, ROWS))
    is_off = rng.uniform(size=(LANES, LIMITS)) < 0.3
    jacobian[:, -LIMITS:][is_off] = target[:, -LIMITS:][is_off] = 0.0
    if size == 1:
        jacobian[:, :EQUALITIES] = 0.0
    problem = {
        "inertia": inertia,
        "efc_J": jacobian,
        "efc_D": 10.0 ** rng.uniform(-1, 3, (LANES, ROWS)),
        "efc_aref": 3.0 * target,
        "efc_frictionloss": rng.exponential(2.0, (LANES, ROWS)),
        "qacc_smooth": rng.normal(size=(LANES, size)),
        "qacc_warmstart": 3.0 * rng.normal(size=(LANES, size)),
    }
    return {name: value.astype(dtype) for name, value in problem.items()}


each_search = pytest.mark.parametrize("search", [search_at_ends, search_by_points])


@functools.partial(jax.jit, static_argnames=("iterations", "search"))
def solved(problems, iterations, search):
    """Accelerations and constraint forces."""

    def one(problem):
        inertia, smooth = problem["inertia"], problem["qacc_smooth"]
        data = SimpleNamespace(
            **problem,
            _impl=SimpleNamespace(**problem, ne=EQUALITIES, nf=SLIDERS),
            qfrc_smooth=inertia @ smooth,
        )
        data.replace = lambda qacc, qfrc_constraint: (qacc, qfrc_constraint)
        model = SimpleNamespace(opt=SimpleNamespace(iterations=iterations))
        return constrained(model, data, inertia, search)

    # As `plain_jax` has it; a GPU would otherwise round factors to 11 bits.
    with jax.default_matmul_precision("highest"):
        return jax.vmap(one)(problems)


def forces(problem, acceleration):
    """The constraint forces of each lane by MuJoCo's formulas, in NumPy."""
    jacobian, stiffness, loss = (
        problem[name].astype(float) for name in ("efc_J", "efc_D", "efc_frictionloss")
    )
    violation = np.einsum("lrv,lv->lr", jacobian, acceleration) - problem["efc_aref"]
    force = -stiffness * violation
    slides = slice(EQUALITIES, EQUALITIES + SLIDERS)
    force[:, slides] = np.clip(force[:, slides], -loss[:, slides], loss[:, slides])
    force[:, -LIMITS:] = np.maximum(force[:, -LIMITS:], 0.0)
    return np.einsum("lrv,lr->lv", jacobian, force)


def assert_minimal(problem, found, rtol):
    acceleration, force = (np.asarray(part, float) for part in found)
    expected = forces(problem, acceleration)
    scale = 1.0 + np.abs(expected).max()
    np.testing.assert_allclose(force, expected, atol=rtol * scale)
    inertial = np.einsum("lvw,lw->lv", problem["inertia"], acceleration - problem["qacc_smooth"])
    np.testing.assert_allclose(inertial, expected, atol=rtol * scale)


@each_search
@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-10), (np.float32, 1e-4)])
def test_the_gradient_of_the_cost_is_zero(dtype, rtol, search):
    problem = problems(5, dtype)
    found = solved(problem, 20, search)
    assert_minimal(problem, found, rtol)
    assert np.abs(np.asarray(found[1])).max() > 1.0


@each_search
def test_a_line_search_is_exact(search):
    """With one degree of freedom, a single iteration searches all accelerations."""
    problem = problems(1, np.float64)
    assert_minimal(problem, solved(problem, 1, search), 1e-10)


def test_an_elliptic_cone_and_another_solver_are_left_to_mjx():
    def applies(option):
        xml = f"<mujoco><option {option}/><worldbody/></mujoco>"
        return has_clipped_forces(RobotModel(xml).compiled())

    assert applies("") and not applies('cone="elliptic"') and not applies('solver="CG"')
