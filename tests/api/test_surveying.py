"""`bojax.survey` is `bojax survey`."""

import json
import re

import numpy as np
import pytest

import bojax
from bojax.surveys.turns import least_radius


def test_a_rectangle_is_surveyed(tmp_path):
    out = tmp_path / "out"
    result = bojax.survey(
        (200.0, 100.0), budget=500.0, end=(0.0, 0.0), turning_radius="5m", lawnmower=True, out=out
    )
    np.testing.assert_array_equal(result.waypoints[-1], [0.0, 0.0])
    assert np.linalg.norm(np.diff(result.waypoints, axis=0), axis=1).sum() <= 500.0 + 1e-6
    assert least_radius(result.waypoints) > 4.999
    assert result.degrees is None
    assert re.match(r"The best of 1\d candidates is: lawnmower", str(result))
    assert (result.folder / "report.html").is_file()
    with pytest.raises(bojax.BojaxError, match="the folder is not empty"):
        bojax.survey((200.0, 100.0), out=tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": (500.0, 5.0)}, "--start: got 500,5, which is not in the area"),
        ({"start": "1,2"}, 'start: got "1,2"; allowed: two numbers, or a list of two for each robot'),
        ({"avoid": "farm.kml"}, "farm.kml: No such file or directory"),
        ({"area": [200.0, 100.0]}, "area: got .*; allowed: a path, or a tuple .width, height."),
    ],
)
def test_a_mistake_is_an_error_of_one_line(tmp_path, change, message):
    with pytest.raises(bojax.BojaxError, match=f"^{message}"):
        bojax.survey(**({"area": (200.0, 100.0), "out": tmp_path / "out"} | change))


def test_the_area_of_a_mission_is_read_from_a_file(tmp_path):
    border, hole = (
        [[x, y], [z, y], [z, w], [x, w], [x, y]] for x, y, z, w in ((0, 0, 2, 1), (1, 0.4, 1.2, 0.6))
    )
    rings = [[[9.0 + 0.01 * x, 54.0 + 0.01 * y] for x, y in ring] for ring in (border, hole)]
    file = tmp_path / "lake.geojson"
    file.write_text(json.dumps({"type": "Polygon", "coordinates": rings}))
    place = bojax.read_place(file)
    start = place.point((9.005, 54.005), "start")
    mission = bojax.Mission(place.area, 3000.0, start, spacing=5.0)
    np.testing.assert_allclose(place.projection.from_local(mission.position), [9.005, 54.005])
    assert place.area.contains(np.array([start, [2.2 * start[0], start[1]]])).tolist() == [True, False]
    with pytest.raises(ValueError, match="^start: got 9.011,54.005, which is not in the area"):
        place.point((9.011, 54.005), "start")
    with pytest.raises(ValueError, match=r"lake2.geojson: No such file"):
        bojax.read_place(tmp_path / "lake2.geojson")
