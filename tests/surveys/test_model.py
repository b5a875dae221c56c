"""The model of a field: learned from an earlier survey, or assumed."""

import json

import jax
import numpy as np
import pytest

from bojax.areas.place import read_place
from bojax.fields.raster import DEGREES
from bojax.surveys import model
from bojax.surveys.model import assumed_model, learned_model
from tests.fields.test_raster_files import written
from tests.reference.gaussian_process import Stationary, matern52
from tests.refusals import one_line


def test_hyper_parameters_of_a_sampled_field_are_recovered(tmp_path, monkeypatch):
    lengthscale, std, noise = 60.0, 2.0, 0.2
    random = np.random.default_rng(3)
    points = random.uniform(0.0, 1000.0, (250, 2))
    covariance = std**2 * Stationary(matern52, None, lengthscale)(points, points)
    values = np.linalg.cholesky(covariance + noise**2 * np.eye(250)) @ random.normal(size=250)
    file = str(tmp_path / "pilot.csv")
    np.savetxt(file, np.column_stack([points, 50.0 + values]), delimiter=";", header="x;y;depth", comments="")
    with jax.enable_x64(True):
        learned = learned_model(file, read_place("1kmx1km"), None)
        # Another prior compiles the learning anew, and what it finds is not looked at.
        monkeypatch.setattr(model, "relearn", lambda gp, key, **_: (gp.with_constant_mean(), None))
        given = learned_model(file, read_place("1kmx1km"), 80.0)
    assert learned.lengthscale == pytest.approx(lengthscale, rel=0.3)
    assert learned.std == pytest.approx(std, rel=0.3)
    assert given.lengthscale == 80.0


def notes_of(monkeypatch, file, area="200x100", lengthscale=None):
    monkeypatch.setattr(model, "relearn", lambda gp, key, **_: (gp.with_constant_mean(), None))
    with jax.enable_x64(True):
        return learned_model(file, read_place(area), lengthscale).notes


def test_what_is_doubtful_in_an_earlier_survey_is_noted(tmp_path, monkeypatch):
    rows = [f"{6 * i},{3 * (i % 7)},{i % 5},{i % 3}" for i in range(30)]
    lacking = ["1,2,NaN,1", "1,2,-9999,1", ",2,3,1"]
    file = written(tmp_path, "old.csv", "\n".join(["x,y,sand,mud", *rows, *lacking]))
    (note,) = notes_of(monkeypatch, f"{file}:sand")
    assert note == f"{file}:sand: 3 of 33 rows have no data and are left out."
    rows = [f"{9.14 + i / 1e4},{54.12 + i % 7 / 1e4},{i % 5}" for i in range(30)]
    (note,) = notes_of(monkeypatch, written(tmp_path, "old.csv", "\n".join(["x,y,z", *rows])))
    assert "all values lie within 0.0029 m, and the area is 200 m wide; check the unit" in note
    np.save(tmp_path / "old.npy", np.arange(100.0).reshape(10, 10) % 7)
    (note,) = notes_of(monkeypatch, str(tmp_path / "old.npy"))
    assert note.endswith("cells are taken to be 1 m wide.")


def test_repeated_and_far_rows_of_an_earlier_survey_are_counted(tmp_path, monkeypatch):
    rows = [f"{6 * i},{3 * (i % 7)},{i % 5}" for i in range(30)]
    for more, counted in (
        (rows[:4], "4 of 34 rows repeat an earlier one; all of them count."),
        (["0,0,3"], None),  # measured again
        (["1e7,5,1", "5,-1e5,2"], "2 of 32 values lie more than 10 widths of the area away from it; check"),
        (["1900,5,1"], None),
    ):
        file = written(tmp_path, "old.csv", "\n".join(["x,y,z", *rows, *more]))
        notes = notes_of(monkeypatch, file)
        assert len(notes) == (counted is not None)
        assert counted is None or notes[0].startswith(f"{file}: {counted}")
    file = written(tmp_path, "old.csv", "\n".join(["x,y,z", *rows, "1e7,5,1"]))
    for lengthscale, end in ((None, ", from which the lengthscale is learned."), (50.0, ".")):
        (note,) = notes_of(monkeypatch, file, lengthscale=lengthscale)
        assert note.endswith(f"check their positions{end}")


def test_metres_are_refused_for_an_area_in_degrees(tmp_path):
    corners = [[9.0, 54.0], [9.01, 54.0], [9.01, 54.01], [9.0, 54.0]]
    area = json.dumps({"type": "Polygon", "coordinates": [corners]})
    rows = [f"{700_000 + i},{4_050_000 + i % 7},{i % 5}" for i in range(30)]
    file = written(tmp_path, "old.csv", "\n".join(["easting,northing,z", *rows]))
    with one_line(ValueError, "old.csv: column easting: got 700029; allowed: longitudes from -360 to 360"):
        learned_model(file, read_place(written(tmp_path, "a.geojson", area)), None)


def test_the_file_without_a_place_on_the_earth_is_named(tmp_path, monkeypatch):
    np.savez(tmp_path / "lake.npz", z=np.ones((5, 5)), x=np.arange(5.0), y=np.arange(5.0))
    old = written(tmp_path, "old.csv", "lon,lat,z\n9,54,1\n")
    with one_line(ValueError, r"old\.csv: has a place on the Earth, and .*lake\.npz has none; allowed: both"):
        notes_of(monkeypatch, old, str(tmp_path / "lake.npz"))


@pytest.mark.parametrize(
    ("names", "at", "away"),
    [
        ("lon,lat", (9.001, 54.001), None),
        ("lat,lon", (9.001, 54.001), "away (longitude and latitude may be swapped)"),
        ("lon,lat", (9.041, 54.001), "2 km away"),
        ("lon,lat", (9.001, 54.0145), "500 m away"),
    ],
)
@pytest.mark.parametrize("crs", [DEGREES, "EPSG:32632"])
def test_how_far_away_all_values_are_is_named(tmp_path, monkeypatch, names, at, away, crs):
    corners = np.array([[9.0, 54.0], [9.01, 54.0], [9.01, 54.01], [9.0, 54.01], [9.0, 54.0]])
    system = {}
    if crs != DEGREES:
        pyproj = pytest.importorskip("pyproj")
        corners = np.stack(pyproj.Transformer.from_crs(DEGREES, crs, always_xy=True).transform(*corners.T), 1)
        system = {"crs": {"type": "name", "properties": {"name": crs}}}
    polygon = {"type": "Polygon", "coordinates": [corners.tolist()]} | system
    area = written(tmp_path, "a.geojson", json.dumps(polygon))
    rows = [f"{at[0] + i / 1e4},{at[1] + i % 7 / 1e4},{i % 5}" for i in range(30)]
    notes = notes_of(monkeypatch, written(tmp_path, "old.csv", "\n".join([f"{names},z", *rows])), area)
    assert len(notes) == (away is not None)
    assert away is None or f"{away}: the model is learned from a field elsewhere." in notes[0]


def test_without_data_the_lengthscale_is_a_tenth_of_the_root_of_the_area():
    assert assumed_model(1e6, None).lengthscale == pytest.approx(100.0)
    assert assumed_model(1e6, 30.0).lengthscale == 30.0
