"""Readers of rasters and points: orientation, holes, projections, and files that are refused."""

import hashlib

import jax.numpy as jnp
import numpy as np
import pytest

from bojax.fields.data import read_array, read_points, sha256_of_files
from bojax.fields.measured import GridField
from bojax.fields.projection import Projection
from bojax.fields.raster import DEGREES
from bojax.fields.raster_files import local_extent, read_local_points, read_raster
from bojax.fields.settings import Grid, Scattered
from tests.refusals import one_line

VALUES = np.array([[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]])
"""From south to north, with a hole."""

ASCII = """ncols 3
nrows 2
xllcorner 100
yllcorner 200
cellsize 10
NODATA_value -1
4 -1 6
1 2 3
"""


def write_tif(path, values=VALUES, crs="EPSG:32633", nodata=-1.0, **more):
    rasterio = pytest.importorskip("rasterio")
    transform = rasterio.transform.from_origin(500_000.0, 5_000_020.0, 10.0, 10.0)
    settings = {"height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32"}
    settings |= {"crs": crs, "nodata": nodata, "transform": transform} | more
    with rasterio.open(path, "w", driver="GTiff", **settings) as file:
        for band in range(settings["count"]):
            file.write(np.nan_to_num(values[::-1], nan=-1.0).astype("float32"), band + 1)
    return str(path)


def written(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return str(tmp_path / name)


def test_an_ascii_raster_begins_in_the_north(tmp_path):
    raster = read_raster(written(tmp_path, "grid.asc", "\ufeff" + ASCII))  # Windows begins a text so
    np.testing.assert_array_equal(raster.values, VALUES)
    np.testing.assert_array_equal(raster.x, [105.0, 115.0, 125.0])
    np.testing.assert_array_equal(raster.y, [205.0, 215.0])
    assert raster.crs is None


def test_a_geotiff_has_the_values_of_its_cells(tmp_path):
    raster = read_raster(write_tif(tmp_path / "a.tif"))
    np.testing.assert_array_equal(raster.values, VALUES)
    np.testing.assert_allclose(raster.x, [500_005.0, 500_015.0, 500_025.0])
    np.testing.assert_allclose(raster.y, [5_000_005.0, 5_000_015.0])
    assert raster.crs == "EPSG:32633"


def test_a_netcdf_file_in_degrees(tmp_path):
    pytest.importorskip("rasterio")
    from scipy.io import netcdf_file

    path = str(tmp_path / "a.nc")
    with netcdf_file(path, "w") as file:
        for name, positions in (("lat", [54.0, 54.5]), ("lon", [10.0, 10.5, 11.0])):
            file.createDimension(name, len(positions))
            variable = file.createVariable(name, "d", (name,))
            variable[:] = positions
            variable.units = "degrees_north" if name == "lat" else "degrees_east"
        depth = file.createVariable("depth", "h", ("lat", "lon"))
        depth._FillValue, depth.scale_factor = np.int16(-1), 0.5
        depth[:] = np.nan_to_num(VALUES * 2, nan=-1)
    raster = read_raster(path)
    np.testing.assert_allclose(raster.values, VALUES)
    np.testing.assert_allclose(raster.y, [54.0, 54.5])
    assert raster.crs == DEGREES


@pytest.mark.parametrize("name", ["masked", "axes"])
def test_an_archive_with_a_mask_or_positions(tmp_path, name):
    filled = np.nan_to_num(VALUES, nan=7.0)
    if name == "masked":
        np.savez(tmp_path / "a.npz", data=filled, mask=np.isnan(VALUES))
    else:
        np.savez(tmp_path / "a.npz", z=VALUES[::-1], longitude=[7.0, 7.1, 7.2], latitude=[51.2, 51.0])
    raster = read_raster(str(tmp_path / "a.npz"))
    np.testing.assert_array_equal(raster.values, VALUES)
    assert raster.crs == (None if name == "masked" else DEGREES)


def test_xyz_cells_in_any_order(tmp_path):
    x, y = np.meshgrid([0.0, 2.0, 4.0], [1.0, 3.0])
    rows = np.column_stack([x.ravel(), y.ravel(), VALUES.ravel()])[::-1]
    path = written(tmp_path, "a.xyz", "\n".join(" ".join(map(str, row)) for row in rows))
    np.testing.assert_array_equal(read_raster(path).values, VALUES)


@pytest.mark.parametrize(
    "text",
    [
        "x,y,depth\n1,2,3.5\n4,5,-9999\n",
        "X;Y;Depth\n1;2;3,5\n4;5;NA\n",
        "station\ty\tx\tdepth\n7\t2\t1\t3.5\n8\t5\t4\t\n",
        "1 2 3.5\n4 5 nan\n",
        "\ufeffx,y,depth\n1,2,3.5\n",
        "\ufeff1,2,3.5\n",
        '"x","y","depth"\n"1","2","3.5"\n',
        "x;y;Höhe\n1;2;3,5\n".encode("latin-1"),
    ],
)
def test_points_with_any_delimiter_encoding_and_named_columns(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    np.testing.assert_array_equal(read_points(str(path)).rows, [[1.0, 2.0, 3.5]])


SAMPLES = """time,station,x,y,Temp,salinity,ns
2024-05-01T10:00:00Z,S0,1,2,0.5,3.5,1.7e18
2024-05-01T10:00:01Z,,4,5,,30,1.7e18
2024-05-01T10:00:02Z,S2,7,8,0.7,-9999,1.7e18
"""


def test_a_column_of_values_is_chosen_by_its_name(tmp_path):
    path = written(tmp_path, "a.csv", SAMPLES)
    for name, column, values in (
        ("salinity", "salinity", [[1, 2, 3.5], [4, 5, 30]]),
        ("TEMP", "Temp", [[1, 2, 0.5], [7, 8, 0.7]]),
    ):
        points = read_points(f"{path}:{name}")
        np.testing.assert_array_equal(points.rows, values)
        assert points.names == ["x", "y", column] and points.left_out == 1
    for name, message in (
        ("", "a.csv: holds several columns of values; allowed: .*a.csv:NAME with one of Temp, salinity, ns$"),
        (":depth", "a.csv: got column depth; allowed: Temp, salinity, ns$"),
        (":station", "a.csv: got column station; allowed: Temp, salinity, ns$"),
        (":x", "a.csv: got column x; allowed: Temp, salinity, ns$"),
    ):
        with one_line(ValueError, message):
            read_points(path + name)
    settings = Scattered(file=f"{path}:salinity")
    assert settings.extent == (1.0, 2.0, 4.0, 5.0)
    assert settings.sha256 == hashlib.sha256(SAMPLES.encode()).hexdigest() == sha256_of_files(path)


def test_columns_of_text_are_ignored_unless_a_row_would_be(tmp_path):
    path = written(tmp_path, "a.csv", "station x y time depth\nS1 1 2 10:30 3\nNA 4 5 10:31 6\n")
    np.testing.assert_array_equal(read_points(path).rows, [[1, 2, 3], [4, 5, 6]])
    for text, message in (
        ("S1,1,2,3\nS2,4,5,6\n", "a.csv: columns of text have no names; allowed: a first line with names"),
        ("x,y,depth\n1,2,3\n4,5,6m\n", "a.csv: could not convert string '6m'"),
        ("x,y\n1,2\n", "a.csv: has no column of values beside x and y"),
        (
            "a,b,c,d\n1,2,3,4\n",
            "a.csv: got columns a, b, c, d; missing: a column x or lon or .*, and a column y",
        ),
    ):
        with one_line(ValueError, message):
            read_points(written(tmp_path, "a.csv", text))
    with one_line(ValueError, "a.csv: got column z, but the columns have no names"):
        read_points(written(tmp_path, "a.csv", "1,2,3\n") + ":z")
    with one_line(ValueError, "could not convert"):  # a grid has no columns to ignore
        read_raster(written(tmp_path, "a.csv", "a,b,c\n1,2,land\n3,4,land\n"))


@pytest.mark.parametrize(
    ("names", "missing"),
    [("lon,depth,temperature", "y or lat"), ("LON,foo,value", "y or lat"), ("depth,lat,value", "x or lon")],
)
def test_one_position_by_its_name_is_not_completed_by_another_column(tmp_path, names, missing):
    listed = names.replace(",", ", ")
    with one_line(ValueError, f"a.csv: got columns {listed}; missing: a column {missing} or [a-z or]*$"):
        read_points(written(tmp_path, "a.csv", f"{names}\n10,54,1\n"))


def test_without_the_names_of_positions_three_columns_are_x_y_and_value(tmp_path):
    for header in ("", "a,b,c\n"):
        path = written(tmp_path, "a.csv", f"{header}10,54,1\n")
        np.testing.assert_array_equal(read_points(path).rows, [[10.0, 54.0, 1.0]])


@pytest.mark.parametrize(
    ("before", "rows", "message"),
    [
        ("", "1,2,<0.5\n", "could not convert string '<0.5' .*on line 2, column 3"),
        ("1,2,3\n", "4,5,<0.5\n", "could not convert string '<0.5' .*on line 3, column 3"),
        ("# a lake\n\n1,2,3\n# noon\n \n", "4,<0.5,6\n", "could not convert string .*on line 7, column 2"),
        ("1,2,NA\n\n", "4,5,3\n6,7,<0.5\n", "could not convert string .*on line 5, column 3"),
        ("1,2,NA\n", "4,5,6!7\n", "could not convert string '6!7' .*on line 3, column 3"),
        ("# a lake\n1,2,3\n\n", "4,5\n", "line 5 has 2 columns, and line 3 has 3; allowed: rows of equal"),
    ],
)
def test_a_row_that_cannot_be_read_is_named_by_its_line_in_the_file(tmp_path, before, rows, message):
    for header, delimiter in (("x,y,z\n", ","), ("x,y,z\n", ";"), ("x,y,z\n", "\t"), ("x,y,z\r\n", " ")):
        text = (header + before + rows).replace(",", delimiter)
        with one_line(ValueError, f"a.csv: {message}"):
            read_array(written(tmp_path, "a.csv", text))
    with one_line(ValueError, "a.csv: line 4 has 2 columns, and line 2 has 3"):  # without names
        read_array(written(tmp_path, "a.csv", "# a lake\n1,2,3\n\n4,5\n"))


@pytest.mark.parametrize(
    ("row", "message"),
    [("10,95,1", "column lat: got 95; allowed: latitudes"), ("400,5,1", "column lon: got 400; allowed: lon")],
)
def test_degrees_out_of_range_are_refused(tmp_path, row, message):
    with one_line(ValueError, f"a.csv: {message}"):
        read_points(written(tmp_path, "a.csv", f"lon,lat,z\n10,54,1\n{row}\n"))


def write_netcdf(path, **variables):
    """A file of variables of values by time, latitude and longitude."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        for name, positions in (
            ("time", [0.0, 1.0, 2.0]),
            ("lat", [54.0, 54.5]),
            ("lon", [10.0, 10.5, 11.0]),
        ):
            file.createDimension(name, len(positions))
            file.createVariable(name, "d", (name,))[:] = positions
        for name, values in variables.items():
            file.createVariable(name, "f", ("time", "lat", "lon"))[:] = values
    return str(path)


def test_a_band_is_chosen_by_its_number(tmp_path):
    pytest.importorskip("rasterio")
    full = np.nan_to_num(VALUES, nan=5.0)
    slices = np.stack([full, full + 10.0, full + 20.0])
    one = write_netcdf(tmp_path / "one.nc", sst=slices)
    two = write_netcdf(tmp_path / "two.nc", sst=slices, salt=-slices)
    tif = write_tif(tmp_path / "a.tif", full, count=3)
    for file, expected in (
        (f"{one}::2", full + 10.0),
        (f"{one}:sst:3", full + 20.0),
        (f"{two}:salt:1", -full),
        (f"{tif}::3", full),
    ):
        np.testing.assert_array_equal(read_raster(file).values, expected)
    for file, message in (
        (one, "one.nc: has 3 bands; allowed: .*one.nc::BAND with one of 1 to 3$"),
        (f"{two}:salt", "two.nc: has 3 bands; allowed: .*two.nc:salt:BAND with one of 1 to 3$"),
        (f"{two}:salt:4", "two.nc: got band 4; allowed: 1 to 3$"),
        (two, "two.nc: holds several variables; allowed: .*two.nc:NAME with one of sst, salt$"),
        (f"{two}:foo", "two.nc: got variable foo; allowed: sst, salt$"),
        (f"{one}:foo:2", "one.nc: got variable foo; allowed: sst$"),
        (f"{tif}:2", "a.tif: got 2; allowed: .*a.tif::BAND$"),
        (f"{tmp_path / 'no.nc'}:sst", "no.nc: No such file or directory$"),
    ):
        with one_line(ValueError, message):
            read_raster(file)


def test_a_raster_without_positions_is_named(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((2, 3)))
    np.savez(tmp_path / "a.npz", z=np.ones((2, 3)), extent=[0, 0, 600, 400])
    np.savez(tmp_path / "b.npz", z=np.ones((2, 3)), x=[0.0, 5.0, 10.0], y=[0.0, 5.0])
    assert [len(read_raster(str(tmp_path / name)).notes) for name in ("a.npy", "a.npz", "b.npz")] == [1, 1, 0]


def test_values_have_the_name_and_the_unit_of_their_file(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    from scipy.io import netcdf_file

    tif, plain = (write_tif(tmp_path / name) for name in ("a.tif", "plain.tif"))
    with rasterio.open(tif, "r+") as file:
        file.set_band_description(1, "turbidity")
        file.set_band_unit(1, "NTU")
    sea = write_netcdf(tmp_path / "sea.nc", sst=np.ones((3, 2, 3)), ratio=np.ones((3, 2, 3)))
    with netcdf_file(sea, "a") as file:
        file.variables["sst"].units, file.variables["ratio"].units = "degC", "1"
    np.savez(tmp_path / "named.npz", depth=np.ones((2, 3)))
    np.savez(tmp_path / "nameless.npz", np.ones((2, 3)))
    rows = "\n".join(f"{i % 3},{i // 3},{i}" for i in range(6))
    for file, label in (
        (tif, "turbidity (NTU)"),
        (plain, ""),
        (f"{sea}:sst:2", "sst (degC)"),
        (f"{sea}:ratio:1", "ratio"),
        (str(tmp_path / "named.npz"), "depth"),
        (str(tmp_path / "nameless.npz"), ""),
        (written(tmp_path, "a.asc", ASCII), ""),
        (written(tmp_path, "a.xyz", f"x,y,height (m)\n{rows}"), "height (m)"),
        (written(tmp_path, "b.xyz", rows), ""),
    ):
        assert read_raster(file).label == label, file


def test_degrees_become_metres(tmp_path):
    path = written(tmp_path, "a.csv", "lon,lat,z\n10,54,1\n10.01,54,2\n10,54.01,3\n")
    pyproj = pytest.importorskip("pyproj")
    earth = pyproj.Geod(ellps="WGS84")
    east, north = earth.inv(10, 54, 10.01, 54)[2], earth.inv(10, 54, 10, 54.01)[2]
    rows = read_local_points(path)
    np.testing.assert_allclose(rows[:, :2], [[0, 0], [east, 0], [0, north]], rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("crs", [DEGREES, "EPSG:32633", "EPSG:3857", "EPSG:2263"])
def test_a_frame_has_true_lengths_and_goes_back(crs):
    pyproj = pytest.importorskip("pyproj")
    to_crs = pyproj.Transformer.from_crs(DEGREES, crs, always_xy=True)
    middle = (-74.0, 40.7) if crs == "EPSG:2263" else (15.2, 54.0)
    degrees = np.array([middle, (middle[0] + 0.004, middle[1]), (middle[0], middle[1] + 0.004)])
    coordinates = np.stack(to_crs.transform(*degrees.T), axis=1)
    low, high = coordinates.min(0), coordinates.max(0)
    frame = Projection.of(crs, (*low, *high))
    local = frame.to_local(coordinates)
    np.testing.assert_allclose(frame.to_degrees(local), degrees, atol=1e-7)
    earth = pyproj.Geod(ellps="WGS84")
    for end in (1, 2):
        length = earth.inv(*degrees[0], *degrees[end])[2]
        assert np.linalg.norm(local[end] - local[0]) == pytest.approx(length, rel=1e-3)


def test_the_distortion_of_a_map_projection_is_that_of_a_length_at_a_corner():
    pyproj = pytest.importorskip("pyproj")
    x, y = (1.0e6, 1.2e6), (7.0e6, 7.6e6)
    frame = Projection.of("EPSG:3857", (x[0], y[0], x[1], y[1]))
    lengths = []
    for corner in y:
        ends = frame.to_local(np.array([[x[0], corner], [x[0] + 1e3, corner]]))
        true = pyproj.Geod(ellps="WGS84").inv(*frame.to_degrees(ends).ravel())[2]
        lengths.append(true / np.linalg.norm(ends[1] - ends[0]) - 1.0)
    assert frame.distortion == pytest.approx(np.abs(lengths).max(), abs=1e-3) and frame.distortion > 0.03
    assert Projection.of("EPSG:32633", (4e5, 5.9e6, 4.2e5, 5.92e6)).distortion < 1e-3


def test_a_large_raster_is_thinned(tmp_path):
    values = np.arange(10_000.0).reshape(100, 100)
    np.save(tmp_path / "a.npy", values)
    path = write_tif(tmp_path / "a.tif", values)
    for file in (str(tmp_path / "a.npy"), path):
        raster = read_raster(file, most=500)
        assert raster.values.size <= 500 and raster.step == 5
    assert read_raster(path).step == 1


def test_a_field_of_a_file_with_holes(tmp_path):
    path = write_tif(tmp_path / "a.tif")
    with pytest.raises(ValueError, match="1 of 6 cells have no data"):
        Grid(file=path)
    settings = Grid(file=path, holes="nearest")
    assert settings.extent == pytest.approx((0.0, 0.0, 20.0, 10.0), rel=1e-3)
    field = GridField(path, jnp.asarray(settings.extent), holes="nearest")
    in_hole = float(field(jnp.asarray([10.0, 10.0])))
    assert min(abs(in_hole - near) for near in (2.0, 4.0, 6.0)) < 0.01
    assert float(field(jnp.asarray([0.0, 0.0]))) == 1.0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.asc", "ncols 3\nnrows 2\n1 2 3\n4 5 6\n", "a.asc: the header lacks cellsize"),
        ("a.asc", ASCII[:-3], "a.asc: got 5 numbers; the header asks for 2 x 3"),
        ("a.asc", ASCII.replace("4 -1 6\n1 2 3", "-1 -1 -1\n-1 -1 -1"), "a.asc: no cell has data"),
        ("a.csv", "1,2\n-9999,1e20\n1,1e16", "a.csv: got 1e\\+16; allowed: numbers up to"),
        ("a.xyz", "1 2 3\n4 5 6\n7 8 9\n10 11 12\n13 14 15\n", "a.xyz: the points are not on a regular grid"),
        ("a.xyz", "1 2 3 4\n", "a.xyz: got 4 columns; allowed: 3"),
        ("a.gif", "", "a.gif: the name has to end in"),
        ("a.tif", "no picture", "a.tif: "),
        ("a.nc", "", "a.nc: "),
    ],
)
def test_files_that_are_refused_in_one_line(tmp_path, name, text, message):
    pytest.importorskip("rasterio")
    with one_line(ValueError, message):
        read_raster(written(tmp_path, name, text))


def test_rasters_that_are_refused(tmp_path):
    pytest.importorskip("rasterio")
    np.savez(tmp_path / "two.npz", a=np.ones((2, 2)), b=np.ones((2, 2)))
    np.savez(tmp_path / "edges.npz", z=np.ones((2, 2)), x=[0.0, 5.0, 10.0], y=[0.0, 5.0])
    for name, message in (
        ("no.tif", r"no\.tif: No such file"),
        ("two.npz", "holds 2 tables"),
        ("edges.npz", "edges.npz: x: got 3 positions; allowed: 2, one for each column$"),
    ):
        with one_line(ValueError, message):
            read_raster(str(tmp_path / name))
    message = "longitude, then latitude, of a small area .across the date line, longitudes up to 360"
    for extent in ((400_000.0, 0.0, 400_100.0, 100.0), (-179.9, 10.0, 179.9, 11.0)):
        with one_line(ValueError, message):
            Projection.of(DEGREES, extent)


def test_the_ending_of_a_name_may_be_in_capitals(tmp_path):
    path = written(tmp_path, "A.CSV", "1,2\n3,4\n")
    np.testing.assert_array_equal(read_raster(path).values, [[1, 2], [3, 4]])


def test_missing_data_are_not_data(tmp_path):
    path = written(tmp_path, "a.csv", "1,2\n-9999,4\n")
    assert np.isnan(read_array(path, allows_holes=True)).sum() == 1
    with pytest.raises(ValueError, match="1 of 4 cells have no data"):
        Grid(file=path)


def test_the_extent_of_a_raster_in_degrees_is_in_metres(tmp_path):
    np.savez(tmp_path / "a.npz", z=np.ones((2, 2)), lon=[10.0, 11.0], lat=[0.0, 1.0])
    x_min, y_min, x_max, y_max = local_extent(read_raster(str(tmp_path / "a.npz")))
    assert (x_min, y_min) == (0.0, 0.0)
    np.testing.assert_allclose([x_max, y_max], [111_320, 110_574], rtol=1e-3)
