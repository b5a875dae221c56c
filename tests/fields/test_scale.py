"""Values in an unlikely unit are named; quantities in the units in use are not."""

import numpy as np
import pytest

from bojax.config.errors import note_once
from bojax.fields.scale import DOUBTED, unit_doubt
from bojax.fields.settings import Grid, Scattered

SHAPE = np.random.default_rng(0).standard_normal(400)


@pytest.mark.parametrize(
    ("mean", "deviation"),
    [
        (0.0, 0.0),
        (-11.0, 3.0),  # depths, m
        (-5.5e6, 3.2e6),  # depths of the ocean, mm
        (5e7, 3.2e7),  # pressures in the ocean, Pa
        (9.8e8, 5e4),  # gravity, microgals
        (1.76e9, 4e4),  # seconds since 1970 over a day
        (2e8, 3e8),  # cells in a litre of water
        (1e-9, 1e-10),
    ],
)
def test_quantities_in_usual_units_are_not_doubted(mean, deviation):
    assert unit_doubt(mean + deviation * SHAPE) is None


@pytest.mark.parametrize("deviation", [1.01 * DOUBTED, 1e12, 1e200, 1e306])
def test_a_deviation_that_no_usual_unit_has_is_named(deviation):
    values = deviation * (SHAPE - SHAPE.mean()) / SHAPE.std()
    assert "check their unit" in str(unit_doubt(values))
    assert "\n" not in str(unit_doubt(values))
    assert unit_doubt(values / deviation * 0.99 * DOUBTED) is None


def test_values_that_are_not_finite_do_not_count():
    assert unit_doubt(np.array([np.nan, np.inf, 1.0, 2.0])) is None
    assert unit_doubt(np.array([np.nan])) is None


@pytest.mark.parametrize(("factor", "is_noted"), [(1.0, False), (1e9, True)])
def test_a_field_from_a_file_is_noted_once(tmp_path, monkeypatch, capsys, factor, is_noted):
    monkeypatch.chdir(tmp_path)
    note_once.cache_clear()
    rows = factor * np.array([[0.0, 5.0], [-5.0, 3.0]])
    (tmp_path / "grid.csv").write_text("\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    points = [f"{i},{i % 2},{z}" for i, z in enumerate(rows.ravel().tolist())]
    (tmp_path / "points.csv").write_text("\n".join(points))
    for settings, file in ((Grid, "grid.csv"), (Scattered, "points.csv")):
        for _ in range(2):
            settings(file=file, extent=(0.0, 0.0, 5.0, 1.0))
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == is_noted
        assert not lines or lines[0].startswith(
            f"note: {file}: the values have a standard deviation of 3.77e+09"
        )


def test_a_grid_without_positions_is_noted_unless_it_has_an_extent(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    note_once.cache_clear()
    (tmp_path / "grid.csv").write_text("0,1,2\n3,4,5\n")
    assert Grid(file="grid.csv", extent=(0.0, 0.0, 20.0, 10.0)).extent == (0.0, 0.0, 20.0, 10.0)
    assert not capsys.readouterr().err
    for _ in range(2):
        assert Grid(file="grid.csv").extent == (0.0, 0.0, 2.0, 1.0)
    note, *more = capsys.readouterr().err.splitlines()
    assert not more
    assert note.startswith("note: grid.csv: it has no positions of rows and columns")
    assert note.endswith("cells are taken to be 1 m wide. Set `extent` to give the size of the grid.")
