"""An area from a file as obstacles: drives stop at its border, and runs stay inside and reach the end."""

import json
import re
import shlex

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from bojax.areas.area import Area
from bojax.areas.outlined import OutlinedArea
from bojax.engine.build import build
from bojax.fields.raster_files import local_extent, read_raster
from bojax.motions.base import place
from bojax.problems.settings import Monitoring
from tests.planning.samples import f64, monitoring
from tests.problems.test_monitoring import SIZE, drives
from tests.runs import run, tables

OUTER = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.5], [2.0, 2.4], [0.0, 2.0], [0.0, 0.0]]
HOLE = [[1.0, 0.7], [1.6, 0.6], [1.7, 1.3], [1.0, 0.7]]
ZONE = [[2.2, 0.0], [2.6, 0.0], [2.6, 0.5], [2.2, 0.5], [2.2, 0.0]]
SHAPE = shapely.Polygon(OUTER, [HOLE]).difference(shapely.Polygon(ZONE))


@pytest.fixture
def files(tmp_path):
    """An area with a hole, and a no-go zone."""
    names = []
    for name, rings in (("area", [OUTER, HOLE]), ("zone", [ZONE])):
        names.append(tmp_path / f"{name}.geojson")
        names[-1].write_text(json.dumps({"type": "Polygon", "coordinates": rings, "crs": None}))
    return [str(name) for name in names]


def reference_number(area, cell, checks, start, poses):
    """How many poses are reached, and how close a decision was, in cells; with exact distances."""
    at, number, closest = start[:2], 0, np.inf
    outside = min(area.distances(at[None])[0] / cell + 0.5, 0.0)
    for index, pose in enumerate(poses):
        shares = np.arange(1, checks + 1)[:, None] / checks
        depths = area.distances(at + shares * (pose[:2] - at)) / cell + 0.5
        least = outside if index == 0 else 0.0
        closest = min(closest, np.abs(depths - least).min(), np.abs(depths[-1]))
        if depths.min() < least or depths[-1] < 0.0:
            break
        at, number = pose[:2], number + 1
    return number, closest


def test_drives_stop_at_the_border_of_an_area(files):
    outlined = OutlinedArea(files[0], (files[1],), resolution=200, checks=6)
    area, cell = outlined.area, float(outlined.distance.spacing)
    arena = monitoring(walls=None, target_area=None, area=outlined).arena
    drive = jax.jit(lambda start, path: arena.drive(start, path))
    stopped = compared = 0
    for start, path in zip(*drives(200, seed=3), strict=True):
        poses = np.asarray(place(f64(path), f64(start)))
        number, closest = reference_number(area, cell, 6, start, poses)
        line = shapely.LineString([start[:2], *poses[:, :2]])
        found = drive(f64(start), f64(path))
        reached = int(found.is_driven.sum())
        if shapely.buffer(SHAPE, -1.5 * cell).covers(line):
            assert reached == SIZE and not found.collided
        is_inside = shapely.contains_xy(SHAPE, *start[:2])
        if is_inside and line.difference(SHAPE.buffer(2.0 * cell)).length > 1.0 / SIZE / 3:
            assert reached < SIZE
        if closest > 0.5:  # interpolation of the distance is off by less than half a cell
            compared += 1
            assert reached == number, (start, closest)
            stopped += number < SIZE
    assert compared > 100 and stopped > 20


def test_a_robot_beside_the_border_may_come_back_but_not_cross(files):
    outlined = OutlinedArea(files[0])
    blocked = jax.jit(lambda trajectory: outlined.is_blocked(trajectory))
    lines = {
        "back": ([0.5, -0.05], [0.5, 0.1], False),
        "farther out": ([0.5, -0.05], [0.5, -0.1], True),
        "along": ([0.5, -0.05], [0.7, -0.05], True),
        "through the hole": ([1.3, 0.66], [1.6, 1.3], True),
        "inside": ([0.5, 0.05], [0.7, 0.0], False),
    }
    for name, (begin, end, expected) in lines.items():
        trajectory = f64([[*begin, 0.0], [*end, 0.0]])
        assert bool(blocked(trajectory)[0]) == expected, name


def test_the_free_space_is_the_area(files):
    problem = monitoring(walls=None, target_area=None, area=OutlinedArea(files[0], (files[1],)))
    points = np.random.default_rng(0).uniform(0.0, 3.0, (500, 2))
    free = np.asarray(jax.jit(lambda points: problem.arena.is_free(points))(jnp.asarray(points)))
    is_inside = shapely.contains_xy(SHAPE.intersection(shapely.box(0, 0, 3, 2.4)), *points.T)
    far = (
        np.abs(Area(tuple(map(np.array, [OUTER, HOLE]))).without([[np.array(ZONE)]]).distances(points)) > 0.01
    )
    np.testing.assert_array_equal(free[far], is_inside[far])
    assert is_inside[far].any() and not is_inside[far].all()


def settings_of(files, **more):
    settings = {
        "problem.area": json.dumps({"kind": "outline", "file": files[0], "avoid": [files[1]]}),
        "problem.field": "{kind: bumps, centres: [[1.0, 1.0]]}",
        "problem.walls": "null",
        "problem.target_area": "null",
        "problem.start": "[0.2, 0.2, 0]",
        "planner": "random",
        "planner.motions.length": "0.5",
        **{f"problem.{name}": value for name, value in more.items()},
    }
    return [f"{name}={value}" for name, value in settings.items()]


def test_runs_stay_in_the_area_and_end_at_the_point(files, tmp_path):
    words = settings_of(files, budget="7", end="[2.8, 0.2]", max_steps="40", domain="[0,0,3,2.4]")
    words = ["space-modelling", "problem=monitoring", *words, "--runs", "3"]
    out = run(tmp_path / "out", *words, has_report=True)
    runs, steps = tables(out)
    assert runs["success"] == [True] * 3 and max(steps["distance"]) <= 7.0 + 1e-9
    cell = 3.0 / 400
    for file in sorted((out / "arrays").glob("*paths*.npz")):
        points = np.load(file)["paths"][..., :2].reshape(-1, 2)
        points = points[np.isfinite(points).all(axis=1)]
        assert (
            shapely.distance(SHAPE, shapely.points(points)).max() < 1.1 * cell
        )  # half a cell, more at sharp corners
        np.testing.assert_allclose(points[-1], [2.8, 0.2], atol=1e-9)
    manifest = json.loads((out / "manifest.json").read_text())
    rings = [np.array(ring) for ring in manifest["points"][0]["outline"]["area"]]
    assert sum(shapely.Polygon(ring).area for ring in rings[1:]) == pytest.approx(
        shapely.Polygon(HOLE).area, rel=1e-6
    )


def raster_with_a_hole(tmp_path):
    """Depths by longitude and latitude, none on an island, and a no-go zone in the same coordinates."""
    longitude, latitude = 10.0 + 0.0005 * np.arange(21), 54.0 + 0.0005 * np.arange(11)
    values = np.add.outer(np.arange(11.0), np.arange(21.0))
    values[4:8, 5:9] = np.nan
    np.savez(tmp_path / "depth.npz", z=values, lon=longitude, lat=latitude)
    west, east, south, north = longitude[14], longitude[17], latitude[2], latitude[6]
    zone = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    (tmp_path / "zone.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [zone]}))
    return str(tmp_path / "depth.npz"), str(tmp_path / "zone.geojson")


def test_an_area_is_in_the_metres_of_the_field(tmp_path):
    depth, zone = raster_with_a_hole(tmp_path)
    outline = {"kind": "outline", "file": depth, "avoid": [zone]}
    field = {"kind": "grid", "file": depth, "holes": "nearest"}
    settings = Monitoring.model_validate({"kind": "monitoring", "field": field, "area": outline})
    problem = build(settings)
    x_min, y_min, x_max, y_max = local_extent(read_raster(depth))
    x, y = np.linspace(x_min, x_max, 21), np.linspace(y_min, y_max, 11)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    depths = jax.jit(lambda points: problem.field.values(points))(jnp.asarray(points[1, 1:3]))
    np.testing.assert_allclose(depths, [2.0, 3.0])  # cells are where the field has them
    expected = np.ones((11, 21), bool)
    expected[4:8, 5:9] = expected[2:7, 14:18] = False
    free = np.asarray(
        jax.jit(lambda points: problem.arena.is_free(points))(jnp.asarray(points.reshape(-1, 2)))
    )
    is_clear = np.ones((11, 21), bool)  # but for cells on the border of the no-go zone
    is_clear[[2, 6], 14:18] = is_clear[2:7, [14, 17]] = False
    is_clear[[0, -1]] = is_clear[:, [0, -1]] = False  # and rounding at the border of the domain
    np.testing.assert_array_equal(free.reshape(11, 21)[is_clear], expected[is_clear])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": "[1.4, 0.9, 0]"}, "start: \\(1.4, 0.9\\) is not in the area, or lies in a hole of it"),
        ({"start": "[2.4, 0.2, 0]"}, "start: \\(2.4, 0.2\\) is not in the area"),
        ({"budget": "5", "end": "[1.4, 0.9]"}, "end: \\(1.4, 0.9\\) is not in the area"),
        # Around the no-go zone the way is longer than the straight line of 2.6 m.
        ({"budget": "2.61", "end": "[2.8, 0.2]"}, "budget: got 2.61; allowed: >= 2.7.* m, to get from the"),
        (
            {"time_budget": "5.22", "speed": "0.5", "end": "[2.8, 0.2]"},
            "time_budget: got 5.22; allowed: >= 5.*s",
        ),
        (
            {"budget": "3", "end": "[2.8, 0.2]", "start": "null"},
            "got 3; allowed: >= 3.[34].* m, to get from any",
        ),
        ({"area.file": "nowhere.geojson"}, "nowhere.geojson: No such file"),
        ({"area.checks": "1"}, "area.checks: got 1; allowed: >= 4"),
        ({"area.below": "0"}, "has no values; allowed with --below: a raster"),
        ({"area.sha256": "ab"}, "has changed"),
    ],
)
def test_wrong_areas_are_refused_in_one_line(files, refusal, here, settings, message):
    words = ["space-modelling", "problem=monitoring", *settings_of(files, **settings), "--runs", "1"]
    assert re.search(message, refusal(shlex.join(["run", *words])))
