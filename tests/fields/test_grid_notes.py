"""A grid without positions is noted."""

from bojax.config.errors import note_once
from bojax.fields.settings import Grid


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
