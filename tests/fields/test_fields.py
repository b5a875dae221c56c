"""Fields by formula against their formulas, fields by data against SciPy, and what data may not be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator

from bojax.fields.closed_form import Bumps, Step
from bojax.fields.data import read_array
from bojax.fields.measured import GridField, ScatteredField
from bojax.fields.settings import Scattered
from tests.arrays import f64
from tests.parts import FILES

EXTENT = (-1.0, 0.0, 3.0, 2.0)


BUMPS = Bumps(f64([1.0, -0.5]), f64([[0.0, 1.0], [2.0, 0.5]]), f64([0.7, 0.3]))
STEP = Step(f64([1.0, 1.0]), f64(np.pi / 6), f64(2.0), f64(0.4))
evaluate = jax.jit(lambda field, xs: (field.values(xs), field.gradients(xs)))


def points(num=50, seed=0):
    return np.random.default_rng(seed).uniform(EXTENT[:2], EXTENT[2:], (num, 2))


def table():
    return np.random.default_rng(1).normal(size=(5, 7))


@pytest.fixture
def grid(tmp_path):
    np.save(tmp_path / "grid.npy", table())
    return GridField(str(tmp_path / "grid.npy"), f64(EXTENT))


def test_bumps_are_a_sum_of_gaussians():
    xs = points()
    squared = np.sum((xs[:, None] - np.asarray(BUMPS.centres)) ** 2, axis=-1)
    expected = np.exp(-squared / (2.0 * np.asarray(BUMPS.widths) ** 2)) @ np.asarray(BUMPS.heights)
    np.testing.assert_allclose(evaluate(BUMPS, f64(xs))[0], expected, atol=1e-14)


def test_a_step_rises_along_its_direction_and_only_along_it():
    along, across = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)]), np.array([-0.5, np.cos(np.pi / 6)])
    t = np.linspace(-2.0, 2.0, 41)
    values, gradients = evaluate(STEP, f64([1.0, 1.0] + t[:, None] * along))
    np.testing.assert_allclose(values, 2.0 * np.tanh(t / 0.4), atol=1e-13)
    np.testing.assert_allclose(gradients @ across, 0.0, atol=1e-13)
    on_the_line, slope = evaluate(STEP, f64([1.0, 1.0] + t[:, None] * across))
    np.testing.assert_allclose(on_the_line, 0.0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=-1), 2.0 / 0.4, atol=1e-10)


def test_a_grid_is_interpolated_linearly_in_each_direction(grid):
    xs = points()
    x, y = np.linspace(-1.0, 3.0, 7), np.linspace(0.0, 2.0, 5)
    expected = RegularGridInterpolator((y, x), table())(xs[:, ::-1])
    np.testing.assert_allclose(evaluate(grid, f64(xs))[0], expected, atol=1e-12)
    corners = f64([[-1.0, 0.0], [3.0, 0.0], [-1.0, 2.0], [3.0, 2.0]])
    np.testing.assert_allclose(
        evaluate(grid, corners)[0], table()[[0, 0, -1, -1], [0, -1, 0, -1]], atol=1e-12
    )


@pytest.mark.parametrize("field", [BUMPS, STEP, "grid"])
def test_gradients_are_differences(field, grid):
    field = grid if field == "grid" else field
    xs, step = points(), 1e-6
    _, gradients = evaluate(field, f64(xs))
    for axis, unit in enumerate(np.eye(2)):
        ahead, behind = (evaluate(field, f64(xs + sign * step * unit))[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(gradients[:, axis], (ahead - behind) / (2.0 * step), atol=1e-7)


def test_outside_a_grid_the_values_of_its_border_hold(grid):
    outside = f64([[-9.0, 1.0], [9.0, 1.0], [1.0, -9.0], [9.0, 9.0]])
    inside = f64([[-1.0, 1.0], [3.0, 1.0], [1.0, 0.0], [3.0, 2.0]])
    np.testing.assert_allclose(evaluate(grid, outside)[0], evaluate(grid, inside)[0], atol=1e-12)


def test_a_csv_file_with_names_is_the_same_grid(grid, tmp_path):
    np.savetxt(tmp_path / "grid.csv", table(), delimiter=",", header="a,b,c,d,e,f,g", comments="")
    again = GridField(str(tmp_path / "grid.csv"), f64(EXTENT))
    np.testing.assert_allclose(again.table, grid.table, rtol=1e-15)


def scattered(tmp_path, rows, **settings):
    np.save(tmp_path / "rows.npy", rows)
    return ScatteredField(str(tmp_path / "rows.npy"), f64(EXTENT), **settings)


@pytest.mark.parametrize("text", ["", "\n\n", "# a\n# 1,2\n", "x,y\n", "# a\nx,y\n# b\n"])
def test_a_csv_file_without_numbers(tmp_path, recwarn, text):
    path = tmp_path / "empty.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"empty\.csv: holds no numbers$"):
        read_array(str(path))
    assert not recwarn.list


def test_a_measurement_whose_square_would_overflow(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("x,y,value\n0,0,1\n1e300,0,2\n0,1,3\n")
    with pytest.raises(ValueError, match=r"rows\.csv: got 1e\+300; allowed: numbers up to 1e\+15"):
        read_array(str(path))
    path.write_text(FILES["rows.csv"])
    with pytest.raises(ValueError, match=r"numbers up to 1e\+15 in magnitude"):
        Scattered(file=str(path), extent=(0.0, 0.0, 1e300, 1.0))


def test_of_scattered_measurements_a_plane_is_recovered(tmp_path):
    at = np.concatenate([points(40), [[-1.0, 0.0], [3.0, 0.0], [-1.0, 2.0], [3.0, 2.0]]])
    field = scattered(tmp_path, np.column_stack([at, at @ [2.0, -1.0] + 0.5]), resolution=21)
    xs = points(seed=2)
    values, gradients = evaluate(field, f64(xs))
    np.testing.assert_allclose(values, xs @ [2.0, -1.0] + 0.5, atol=1e-10)
    np.testing.assert_allclose(gradients, np.tile([2.0, -1.0], (len(xs), 1)), atol=1e-9)


def test_between_measurements_it_is_linear_and_around_them_the_nearest_one(tmp_path):
    at = points(30) * 0.3 + [0.5, 0.5]
    rows = np.column_stack([at, np.sin(5.0 * at[:, 0]) + at[:, 1]])
    field = scattered(tmp_path, rows, resolution=401)
    xs = points(400, seed=3)
    expected = LinearNDInterpolator(rows[:, :2], rows[:, 2])(xs)
    is_within = np.isfinite(expected)
    found = np.asarray(evaluate(field, f64(xs))[0])
    np.testing.assert_allclose(found[is_within], expected[is_within], atol=0.1)
    assert np.median(np.abs(found - expected)[is_within]) < 0.01
    nearest = rows[np.argmin(np.sum((xs[:, None] - rows[:, :2]) ** 2, axis=-1), axis=1), 2]
    far = np.min(np.sum((xs[:, None] - rows[:, :2]) ** 2, axis=-1), axis=1) > 0.25
    assert np.mean(np.abs(found - nearest)[far] < 1e-9) > 0.95
    assert is_within.sum() > 10 and far.sum() > 50


@pytest.mark.parametrize("number", [1, 2, 3])
def test_few_measurements_or_those_on_a_line_are_extended_by_the_nearest(tmp_path, number):
    rows = np.array([[0.0, 0.5, 1.0], [1.0, 1.0, 2.0], [2.0, 1.5, 4.0], [2.5, 1.75, 8.0]])
    for kept in (rows[:number], rows):  # all of them lie on a line
        found = np.asarray(evaluate(scattered(tmp_path, kept), f64(points()))[0])
        assert np.all(np.isfinite(found))
        assert found.min() >= kept[:, 2].min() and found.max() <= kept[:, 2].max()
        assert evaluate(scattered(tmp_path, kept), f64([[-1.0, 0.0]]))[0][0] == kept[0, 2]


def test_the_precision_is_that_of_the_settings(tmp_path, grid):
    xs = jnp.asarray(points(), jnp.float32)
    single = GridField(str(tmp_path / "grid.npy"), jnp.asarray(EXTENT, jnp.float32))
    for part in evaluate(single, xs):
        assert part.dtype == jnp.float32
    np.testing.assert_allclose(evaluate(single, xs)[0], evaluate(grid, f64(xs))[0], atol=1e-5)


def test_comments_of_a_csv_file_are_skipped(tmp_path):
    (tmp_path / "table.csv").write_text("# a field\nx,y\n1,2  # first\n\n3,4\n")
    np.testing.assert_array_equal(read_array(str(tmp_path / "table.csv")), [[1, 2], [3, 4]])
