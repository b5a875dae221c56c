"""A budget of distance: the robot stops at the last pose that it allows, and planners know that."""

import dataclasses
import json
from functools import partial

import equinox as eqx
import jax
import numpy as np
import pytest
import shapely

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.motions.base import place
from bojax.problems.settings import Monitoring
from tests.planning.samples import OBJECTIVES, f64, field_belief, monitoring
from tests.problems.test_monitoring import SIZE, WALLED, drives
from tests.runs import run, tables

BUDGET = 1.1
LIMITED = monitoring(walls=None, target_area=None, budget=f64(BUDGET), errors_by_step=True)


def reference_within(start, poses, is_driven, left):
    """How many poses are reached within a distance, and what is left; 0 if a pose could not be reached."""
    at, number = start[:2], 0
    for pose, driven in zip(poses, is_driven, strict=True):
        gap = np.linalg.norm(pose[:2] - at)
        if not driven:
            break
        if gap > left + 1e-9:
            return number, 0.0
        at, left, number = pose[:2], left - gap, number + 1
    return number, left


@jax.jit
def cut(start, path, left):
    drive = WALLED.arena.drive(start, path)
    return drive, *drive.within(start, left)


@pytest.mark.parametrize("left", [0.0, 0.2, 0.55, 3.0])
def test_a_drive_is_cut_where_the_distance_ends(left):
    for start, path in zip(*drives(100, seed=5), strict=True):
        whole, part, rest = jax.tree.map(np.asarray, cut(start, path, np.asarray(left)))
        number, expected = reference_within(start, whole.poses, whole.is_driven, left)
        np.testing.assert_array_equal(part.is_driven, np.arange(SIZE) < number)
        np.testing.assert_allclose(rest, expected, atol=1e-9)
        ends = np.concatenate([start[None], np.asarray(place(f64(path), f64(start)))])
        np.testing.assert_allclose(part.poses[-1][:2], ends[number][:2], atol=1e-12)
        is_cut = number < whole.is_driven.sum()
        assert (part.collided, part.exited) == ((False, False) if is_cut else (whole.collided, whole.exited))


START = (1.5, 1.2, 0.3)


def simulated_and_driven(problem, num_paths):
    """A simulation of paths from `START` as a function of what is left, and their drives, without noise.

    Both end at the same path, which is the last one but not the first, with the same distance left.
    """
    root, node = problem.root(field_belief(problem, START, 5), num_paths)
    _, paths = drives(num_paths, seed=2)

    @jax.jit
    def simulate(left):
        own = dataclasses.replace(node, left=left)
        return problem.simulate(jax.random.key(1), root, own, f64(paths), OBJECTIVES["value"])

    world = dataclasses.replace(problem, start=f64(START), noise=f64(0.0)).reset(jax.random.key(0))
    execute, driven = jax.jit(type(problem).execute), []
    for path in paths:
        driven.append(execute(problem, jax.random.key(2), world, f64(path)))
        world = driven[-1][0]
    found = simulate(node.left)
    np.testing.assert_array_equal(found.terminated, [events.terminated for _, _, events in driven])
    assert found.terminated[-1] and not found.terminated[0]
    np.testing.assert_allclose(found.node.left, driven[0][0].left, atol=1e-9)
    return found, simulate, driven


def test_a_simulation_ends_where_the_world_does():
    found, simulate, driven = simulated_and_driven(LIMITED, 3)
    world, _, _ = driven[-1]
    assert world.distance <= BUDGET + 1e-9 and world.left == 0.0
    # What lies beyond the budget is not paid, as it is with a larger one.
    is_beyond = np.array([not samples.is_taken.any() for _, samples, _ in driven])
    assert is_beyond.any()
    np.testing.assert_array_equal(np.asarray(found.rewards)[is_beyond], 0.0)
    wide = simulate(f64(100.0))
    assert not wide.terminated.any() and np.abs(np.asarray(wide.rewards)[is_beyond]).min() > 0.0


def test_without_a_budget_nothing_is_measured():
    plain = monitoring()
    assert {"distance", "rmse"}.isdisjoint(column.name for column in plain.step_columns)
    world = plain.reset(jax.random.key(0))
    assert world.distance is None and world.left is None
    assert plain.belief_row(world, plain.prior(jax.random.key(0), world, SIZE)) == {}


def test_a_run_ends_with_its_budget_and_its_steps_have_the_errors(tmp_path):
    config = tmp_path / "survey.yaml"
    config.write_text(
        "experiment: planning\nproblem: {kind: monitoring, budget: 3.3, errors_by_step: true, resolution: 9, "
        "max_steps: 30}\nplanner: {kind: random}\nruns: 3\n"
    )
    out = run(tmp_path / "out", str(config), has_report=True)
    runs, steps = tables(out)
    for own_run, rmse, number in zip(runs["run"], runs["rmse"], runs["steps"], strict=True):
        own = [index for index, each in enumerate(steps["run"]) if each == own_run]
        distance = [steps["distance"][index] for index in own]
        assert len(own) == number and np.all(np.diff(distance) >= 0.0)
        assert steps["done"][own[-1]] and 2.3 <= distance[-1] <= 3.3 + 1e-9
        np.testing.assert_allclose(steps["rmse"][own[-1]], rmse, rtol=1e-12)  # of two programs
    assert (out / "figures" / "errors-by-distance.svg").exists()


def test_errors_in_a_region_are_those_of_plain_numpy():
    region = (0.5, 0.4, 1.6, 2.0)  # over a wall, whose points do not count
    problem = monitoring(errors_by_step=True, region=f64(region))
    whole = monitoring(errors_by_step=True)
    belief, points = field_belief(problem, (0.5, 1.2, 0.5), 9), problem.grid()

    @eqx.filter_jit
    def computed():
        world = problem.reset(jax.random.key(0))
        rows = [list(each.belief_row(world, belief).items()) for each in (problem, whole)]
        return *rows, *belief.posterior.predict(points), problem.true_field.values(points)

    row, of_whole, mean, variance, truth = jax.device_get(computed())
    row, of_whole = dict(row), dict(of_whole)
    assert [column.name for column in problem.step_columns][-6:] == list(row)
    x, y = np.asarray(points).T
    counts = (x >= region[0]) & (x <= region[2]) & (y >= region[1]) & (y <= region[3])
    for x_min, y_min, x_max, y_max in np.asarray(problem.walls):
        counts &= ~((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max))
    error, variance = (mean - truth)[counts], variance[counts]
    nll = 0.5 * np.log(2.0 * np.pi * variance) + error**2 / (2.0 * variance)
    expected = {"rmse": np.sqrt(np.mean(error**2)), "mnll": nll.mean(), "mean_std": np.sqrt(variance).mean()}
    for name, value in expected.items():
        np.testing.assert_allclose(row[f"{name}_region"], value, rtol=1e-9)
    assert {name: row[name] for name in expected} == of_whole


def test_a_region_needs_errors_by_step_and_points_of_the_grid():
    with pytest.raises(ValueError, match="region: no free point of the grid"):
        monitoring(errors_by_step=True, region=f64((0.01, 0.01, 0.02, 0.02)))
    with pytest.raises(ValueError, match="region: needs errors_by_step"):
        Monitoring(region=(0.0, 0.0, 1.0, 1.0))


def test_the_errors_of_a_region_of_polygons_are_those_of_its_points_in_the_frame_of_the_area(tmp_path):
    corners = {
        "area": [[0, 0], [3, 0], [3, 2], [0, 2], [0, 0]],
        "part": [[1, 0.1], [2.9, 0.1], [1, 1.5], [1, 0.1]],
    }
    for name, ring in corners.items():
        degrees = [[10.0 + 1e-5 * x, 54.0 + 1e-5 * y] for x, y in ring]  # about 0.65 by 1.11 m a unit
        (tmp_path / f"{name}.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [degrees]}))
    files = {name: str(tmp_path / f"{name}.geojson") for name in corners}
    settings = Monitoring(
        area={"kind": "outline", "file": files["area"]}, region=files["part"], errors_by_step=True
    )
    assert Monitoring.model_validate(settings.model_dump()) == settings
    problem = build(settings)
    grid = np.asarray(problem.grid())
    width, height = np.ptp(np.asarray(problem.domain).reshape(2, 2), axis=0)
    part = shapely.Polygon(np.array(corners["part"]) * [width / 3.0, height / 2.0])
    cell = float(problem.region.distance.spacing)
    is_clear = shapely.distance(part.boundary, shapely.points(grid)) > cell
    expected = shapely.contains_xy(part, *grid.T)
    assert 50 < expected.sum() < 500 and is_clear.mean() > 0.95
    found = np.asarray(problem._is_in_region(problem.grid()))
    np.testing.assert_array_equal(found[is_clear], expected[is_clear])
    elsewhere = tmp_path / "far.geojson"
    elsewhere.write_text((tmp_path / "part.geojson").read_text().replace("[10.0", "[10.1"))
    of_area = partial(Monitoring, area={"kind": "outline", "file": files["area"]}, errors_by_step=True)
    with pytest.raises(ConfigError, match="region: no free point of the grid"):
        build(of_area(region=str(elsewhere)))
    with pytest.raises(ValueError, match="is in degrees or a map projection, and the problem has no place"):
        Monitoring(region=files["part"], errors_by_step=True)
    with pytest.raises(ValueError, match=r"no.kml: No such file"):
        of_area(region="no.kml")
    metres = tmp_path / "metres.geojson"
    metres.write_text(json.dumps({"type": "Polygon", "coordinates": [corners["part"]], "crs": None}))
    with pytest.raises(ValueError, match=r"metres.geojson: "):
        of_area(region=str(metres))
