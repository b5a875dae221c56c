"""`bojax.survey` is `bojax survey`."""

import numpy as np
import pytest

import bojax

pytest.importorskip("shapely")


def test_a_rectangle_is_surveyed(tmp_path):
    result = bojax.survey((200.0, 100.0), budget=500.0, end=(0.0, 0.0), lawnmower=True, out=tmp_path / "out")
    np.testing.assert_array_equal(result.waypoints[-1], [0.0, 0.0])
    assert np.linalg.norm(np.diff(result.waypoints, axis=0), axis=1).sum() <= 500.0 + 1e-6
    assert result.degrees is None
    assert str(result).startswith("The best of 16 candidates is: lawnmower")
    assert (result.folder / "report.html").is_file()
    with pytest.raises(bojax.BojaxError, match="the folder is not empty"):
        bojax.survey((200.0, 100.0), out=tmp_path / "out")


def test_a_mistake_is_an_error_of_one_line(tmp_path):
    with pytest.raises(bojax.BojaxError, match=r"^--start: got 500,5, which is not in the area"):
        bojax.survey((200.0, 100.0), start=(500.0, 5.0), out=tmp_path / "out")
