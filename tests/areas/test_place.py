"""Areas from files: GeoJSON with a hole, KML, rasters with holes, sizes, and what is refused in one line."""

import json
from functools import partial

import numpy as np
import pytest

pyproj = pytest.importorskip("pyproj")

from bojax.areas.place import read_outlined, read_place  # noqa: E402
from bojax.fields.raster import DEGREES  # noqa: E402
from tests.fields.test_raster_files import ASCII, write_tif, written  # noqa: E402
from tests.refusals import assert_refused, one_line  # noqa: E402

OUTER = [[10.0, 54.0], [10.02, 54.0], [10.02, 54.01], [10.0, 54.01], [10.0, 54.0]]
HOLE = [[10.008, 54.004], [10.012, 54.004], [10.012, 54.006], [10.008, 54.006], [10.008, 54.004]]
BOW_TIE = [[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]]


def kml(*borders) -> str:
    def ring(corners):
        text = " ".join(f"{x},{y},0" for x, y in corners)
        return f"<LinearRing><coordinates>{text}</coordinates></LinearRing>"

    outer, *inner = map(ring, borders)
    holes = "".join(f"<innerBoundaryIs>{each}</innerBoundaryIs>" for each in inner)
    polygon = f"<Polygon><outerBoundaryIs>{outer}</outerBoundaryIs>{holes}</Polygon>"
    return f'<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark>{polygon}</Placemark></kml>'


def geojson(*rings, **more) -> str:
    return json.dumps({"type": "Polygon", "coordinates": rings, **more})


@pytest.mark.parametrize("name", ["a.geojson", "a.kml"])
def test_a_polygon_with_a_hole_has_its_size_on_the_earth(tmp_path, name):
    text = kml(OUTER, HOLE) if name.endswith("kml") else geojson(OUTER, HOLE)
    place = read_place(written(tmp_path, name, text))
    earth = pyproj.Geod(ellps="WGS84")
    expected = [abs(earth.polygon_area_perimeter(*np.array(ring).T)[0]) for ring in (OUTER, HOLE)]
    assert place.size == pytest.approx(expected[0] - expected[1], rel=1e-3)
    middle, beside = place.projection.to_local(np.array([[10.01, 54.005], [10.001, 54.001]]))
    assert not place.area.contains(middle[None])[0]
    assert place.area.contains(beside[None])[0]
    assert place.projection.crs == DEGREES


def test_features_and_collections(tmp_path):
    polygon = json.loads(geojson(OUTER))
    other = json.loads(geojson([[x + 1, y] for x, y in OUTER]))
    line = {"type": "Feature", "properties": None, "geometry": {"type": "LineString", "coordinates": OUTER}}
    features = [{"type": "Feature", "properties": None, "geometry": each} for each in (polygon, other)]
    text = json.dumps({"type": "FeatureCollection", "features": [line, *features]})
    both = read_place(written(tmp_path, "a.geojson", text))
    one = read_place(written(tmp_path, "b.geojson", geojson(OUTER)))
    assert both.size == pytest.approx(2 * one.size, rel=1e-6)


def test_local_metres_and_a_map_projection(tmp_path):
    square = [[0, 0], [100, 0], [100, 50], [0, 50], [0, 0]]
    place = read_place(written(tmp_path, "a.geojson", geojson(square, crs=None)))
    assert place.size == pytest.approx(5000.0)
    utm = {"type": "name", "properties": {"name": "EPSG:32632"}}
    moved = [[x + 500_000, y + 6_000_000] for x, y in square]
    place = read_place(written(tmp_path, "b.geojson", geojson(moved, crs=utm)))
    assert place.size == pytest.approx(5000.0 / 0.9996**2, rel=1e-6)
    assert place.bounds == pytest.approx((500_000, 6_000_000, 500_100, 6_000_050))


def test_a_geotiff_with_holes_is_its_cells_with_data(tmp_path):
    values = np.ones((40, 50))
    values[10:20, 10:30] = np.nan
    values[35:, :10] = np.nan
    place = read_place(write_tif(tmp_path / "a.tif", values))
    assert place.size == pytest.approx((2000 - 200 - 50) * 100.0, rel=0.01)
    x_min, y_min, _, _ = place.bounds
    assert (x_min, y_min) == pytest.approx((500_000.0, 5_000_020.0 - 400.0))
    rows, columns = np.meshgrid(np.arange(40), np.arange(50), indexing="ij")
    # The raster begins in the south after reading: row 0 of `values` is the southernmost.
    centres = np.stack([500_005.0 + 10.0 * columns.ravel(), 4_999_625.0 + 10.0 * rows.ravel()], axis=1)
    inside = place.area.contains(place.projection.to_local(centres))
    np.testing.assert_array_equal(inside, ~np.isnan(values).ravel())


def test_an_ascii_raster_below_a_level(tmp_path):
    text = ASCII.replace("ncols 3\nnrows 2", "ncols 4\nnrows 4").rpartition("NODATA_value -1\n")[0]
    file = written(tmp_path, "a.asc", text + "\n".join(["-5 -5 3 3"] * 4))
    corners = 4 * 10.0**2 / 8  # which the border cuts
    assert read_place(file).size == pytest.approx(1600.0 - corners)
    assert read_place(file, below=0.0).size == pytest.approx(800.0 - corners)
    with pytest.raises(ValueError, match="no cell is below -10: the values are from -5 to 3"):
        read_place(file, below=-10.0)


def test_zones_are_taken_away(tmp_path):
    place = read_place(written(tmp_path, "a.geojson", geojson(OUTER)))
    cut = place.without(written(tmp_path, "zone.kml", kml(HOLE)))
    with_hole = read_place(written(tmp_path, "b.geojson", geojson(OUTER, HOLE)))
    assert cut.size == pytest.approx(with_hole.size, rel=1e-9)
    far = [[x + 1, y] for x, y in HOLE]
    assert "no part of it is in the area" in place.without(written(tmp_path, "far.kml", kml(far))).notes[-1]
    with pytest.raises(ValueError, match=r"whole\.geojson: its no-go zones leave nothing of the area"):
        place.without(written(tmp_path, "whole.geojson", geojson(OUTER)))


def test_a_zone_in_another_projection_is_moved(tmp_path):
    place = read_place(written(tmp_path, "a.geojson", geojson(OUTER)))
    to_utm = pyproj.Transformer.from_crs(DEGREES, "EPSG:32632", always_xy=True)
    utm = {"type": "name", "properties": {"name": "EPSG:32632"}}
    hole = [list(to_utm.transform(*corner)) for corner in HOLE]
    cut = place.without(written(tmp_path, "zone.geojson", geojson(hole, crs=utm)))
    with_hole = read_place(written(tmp_path, "b.geojson", geojson(OUTER, HOLE)))
    assert cut.size == pytest.approx(with_hole.size, rel=1e-6)
    local = written(tmp_path, "local.geojson", geojson(HOLE, crs=None))
    whole = str(tmp_path / "a.geojson")
    has_place = rf"a\.geojson: has a place on the Earth, and {local} has none"
    assert_refused(
        [
            (
                lambda: place.without(local),
                rf"local\.geojson: has no place on the Earth, and {whole} has one",
            ),
            (lambda: read_place(local).without(whole), has_place),
            (lambda: read_outlined(whole, (), None, local, None), has_place),
        ]
    )


@pytest.mark.parametrize(
    ("text", "size"), [("500x300", 150_000.0), ("2kmx1.5km", 3e6), ("2x1km", 2e6), ("10m x 20m", 200.0)]
)
def test_sizes(text, size):
    assert read_place(text).size == pytest.approx(size)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.geojson", geojson(BOW_TIE), r"polygon 1 of 1: crosses itself .*at 5 5"),
        ("a.geojson", geojson(OUTER[:2]), "polygon 1 of 1: "),
        ("a.geojson", geojson([["a", 1], [1, 2], [3, 4]]), "polygon 1 of 1: could not convert"),
        ("a.geojson", geojson([[np.nan, 1], [1, 2], [3, 4]]), "polygon 1 of 1: a corner is not finite"),
        ("a.geojson", json.dumps({"type": "Point", "coordinates": [0, 0]}), "holds no polygon"),
        ("a.geojson", "[]", "is not GeoJSON"),
        ("a.geojson", "{", "is not JSON: Expecting property name"),
        ("a.geojson", geojson([[400_000, 0], [400_100, 0], [400_100, 90]]), "longitude, then latitude"),
        ("a.kml", '<!DOCTYPE k [<!ENTITY a "a">]><kml/>', "has a document type"),
        ("a.kml", "<kml>", "no element found"),
        ("a.kml", "<kml/>", "holds no polygon"),
        ("a.shp", "", "allowed: a size such as 500x300, or a file.*ogr2ogr area.geojson"),
        ("a.npy", "", "a.npy: "),
    ],
)
def test_areas_that_are_refused_in_one_line(tmp_path, name, text, message):
    with one_line(ValueError, f"{name}.*{message}" if name not in message else message):
        read_place(written(tmp_path, name, text))


def test_names_that_are_refused():
    refused = ("0x5", "lengths above 0"), ("no.kml", "No such file"), ("big", "a size")
    assert_refused((partial(read_place, text), message) for text, message in refused)


def test_a_point_outside_is_refused(tmp_path):
    place = read_place(written(tmp_path, "a.geojson", geojson(OUTER, HOLE)))
    np.testing.assert_allclose(place.point((10.0, 54.0), "--start"), [0.0, 0.0])
    with pytest.raises(
        ValueError, match=r"--start: got 10\.01,54\.005, which is not in the area; allowed: .*x from 10 to"
    ):
        place.point((10.01, 54.005), "--start")


def test_a_raster_without_positions_is_named_and_a_band_is_chosen(tmp_path):
    np.savez(tmp_path / "a.npz", z=np.ones((4, 6)), extent=[0, 0, 600, 400])
    (note,) = read_place(str(tmp_path / "a.npz")).notes
    assert note.endswith("cells are taken to be 1 m wide.")
    tif = write_tif(tmp_path / "a.tif", np.ones((4, 6)), count=2)
    assert read_place(f"{tif}::2").size == pytest.approx(2400.0, rel=0.05)
