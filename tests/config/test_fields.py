"""Fields from files: accepted formats, refused files, and the checksum of the data in the settings."""

import hashlib
import io
import os

import numpy as np
import pytest

from bojax.config.component import Component
from bojax.config.errors import ConfigError
from bojax.config.sweep import load_config
from bojax.fields.data import read_array
from bojax.fields.settings import Grid, Scattered

TABLE = np.array([[1.0, 2.5, -3.0], [0.25, 1e-3, 7.0]])
EXTENT = (0.0, 0.0, 2.0, 1.0)


def test_a_table_reads_the_same_from_both_formats(write, tmp_path):
    np.save(tmp_path / "table.npy", TABLE)
    rows = "\n".join(",".join(map(repr, row)) for row in TABLE.tolist())
    write("bare.csv", rows)
    write("named.csv", "left,middle,right\n" + rows)
    for file in ("table.npy", "bare.csv", "named.csv"):
        np.testing.assert_array_equal(read_array(file), TABLE)


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int64, np.float32])
def test_all_types_of_real_numbers_are_read(write, tmp_path, dtype):
    np.save(tmp_path / "table.npy", np.array([[0, 1], [1, 0]], dtype))
    table = read_array(str(tmp_path / "table.npy"))
    assert table.dtype == np.float64
    np.testing.assert_array_equal(table, [[0.0, 1.0], [1.0, 0.0]])


NOT_TABLES = {
    "a line": np.arange(3.0),
    "a cube": np.zeros((2, 2, 2)),
    "words": np.array([["a", "b"], ["c", "d"]]),
    "objects": np.array([[None, 1], [2, 3]], dtype=object),
    "infinity": np.array([[np.inf, 1.0], [0.0, 0.0]]),
    "complex numbers": np.array([[1.0 + 2.0j, 1.0], [0.0, 0.0]]),
    "records": np.zeros((2, 2), [("x", float), ("y", int)]),
    "dates": np.zeros((2, 2), "datetime64[s]"),
    "nothing": np.zeros((0, 3)),
    "more than float64 holds": np.full((2, 2), np.longdouble("1e4000")),
}


def saved(table: np.ndarray) -> bytes:
    np.save(stream := io.BytesIO(), table, allow_pickle=True)
    return stream.getvalue()


def header(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    """A file of NumPy's format that claims an array, and holds a single number."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue() + bytes(8)


def test_anything_but_a_whole_table_of_finite_numbers_is_refused_in_one_line(tmp_path):
    path, whole = tmp_path / "table.npy", saved(TABLE)
    claims = [header((10**10, 10**10)), header((10**6, 10**6)), header((2, -1)), header((2, 2), "|O")]
    for content in (*map(saved, NOT_TABLES.values()), b"", whole[:20], whole[:-8], b"not a table", *claims):
        path.write_bytes(content)
        with pytest.raises(ValueError) as raised:
            read_array(str(path))
        assert str(raised.value).startswith(str(path)) and "\n" not in str(raised.value)


def test_an_archive_under_the_name_of_an_array(tmp_path):
    np.savez(tmp_path / "table.npz", TABLE)
    path = (tmp_path / "table.npz").rename(tmp_path / "table.npy")
    with pytest.raises(ValueError, match=r"table.npy: is an archive \(.npz\); a single array"):
        read_array(str(path))


@pytest.mark.parametrize("name", ["table.npy", "table.csv"])
def test_only_regular_files_are_read(tmp_path, name):
    os.mkfifo(tmp_path / name)  # opening it would wait for ever
    with pytest.raises(ValueError, match=f"{name}: is not a regular file"):
        read_array(str(tmp_path / name))


@pytest.mark.parametrize("schema", [Grid, Scattered])
def test_the_settings_hold_the_checksum_of_the_file(write, schema: type[Component]):
    path = write("table.csv", "0,0,1\n1,0,2\n0,1,3")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    settings = schema(file="table.csv", extent=EXTENT)
    assert settings.model_dump()["sha256"] == digest
    assert schema.model_validate(settings.model_dump()) == settings
    # Other data in a file of the same name are different settings: results are not resumed with them.
    path.write_text("0,0,1\n1,0,2\n0,1,4")
    assert schema(file="table.csv", extent=EXTENT) != settings
    with pytest.raises(ValueError, match="the file has changed"):
        schema.model_validate(settings.model_dump())


def test_a_custom_field_is_ten_lines_of_yaml(write):
    write("depth.csv", "1,2\n3,4")
    write(
        "x.yaml",
        "{problem: {kind: monitoring, field: {kind: grid, file: depth.csv, extent: [0, 0, 6, 6]}, "
        "start: [1, 1, 0]}, planner: myopic}",
    )
    problem = load_config("x.yaml").points[0].config.problem
    assert (problem.field.kind, problem.field.extent) == ("grid", (0.0, 0.0, 6.0, 6.0))
    with pytest.raises(ConfigError, match=r"good.csv: No such file or directory"):
        load_config("x.yaml", ["problem.field.file=good.csv"])
