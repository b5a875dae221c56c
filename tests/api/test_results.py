"""Results as Python objects: tables as they were written, claims, and figures that a notebook shows."""

import json
import re
from functools import partial

import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

import bojax
from bojax.report.build import build_report
from tests.refusals import assert_refused, one_line
from tests.report.synthetic import CLAIMS, write_results


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = write_results(tmp_path_factory.mktemp("api") / "results", report={"figures": ["returns"]})
    build_report(folder)
    return bojax.load(str(folder))


def test_tables_are_those_of_the_folder(results):
    for name in ("runs", "steps"):
        assert getattr(results, name).equals(pq.read_table(results.folder / f"{name}.parquet"))
    with pytest.raises(bojax.BojaxError, match="no table episodes; allowed: runs, steps"):
        _ = results.episodes


def test_they_stay_those_of_the_folder_in_another_working_directory(results, tmp_path, monkeypatch):
    monkeypatch.chdir(results.folder.parent)
    found = bojax.load(results.folder.name)
    monkeypatch.chdir(tmp_path)
    assert found.folder == results.folder and found.runs.equals(results.runs)
    assert found.show("returns").png == results.show("returns").png


def test_claims_have_the_verdicts_of_the_file(results):
    written = json.loads((results.folder / "claims.json").read_text())
    assert results.claims.num_rows == len(CLAIMS) == len(written)
    for row, claim in zip(results.claims.to_pylist(), written, strict=True):
        assert (row["id"], row["verdict"], row["runs"]) == (claim["id"], claim["verdict"], claim["runs"])
        assert [row["low"], row["high"]] == (claim["interval"] or [None, None])


def test_settings_and_paths(results):
    assert results.manifest["status"] == "finished"
    assert results.report == results.folder / "report.html"
    assert str(results.folder) in repr(results) and results.manifest["title"] in results._repr_html_()


def test_a_figure_is_a_picture_with_its_caption(results):
    picture, first = results.show("accumulated-reward"), results.show()
    assert isinstance(picture.figure, Figure) and picture._repr_png_().startswith(b"\x89PNG")
    assert re.search(r'<img src="data:image/png;base64,\w.*alt="[^"]{20,}"', picture._repr_html_())
    assert picture.caption in repr(picture) and first.title != picture.title
    assert first.png == (results.folder / "figures" / "returns.png").read_bytes()


def test_a_figure_that_cannot_be_drawn_is_one_line(results):
    with pytest.raises(bojax.BojaxError, match='unknown figure return; .*value-maps; did you mean "returns"'):
        results.show("return")
    with one_line(bojax.BojaxError, "the figure learning-curves is not drawn: "):
        results.show("learning-curves")


def test_what_is_no_results_folder_is_refused(results, tmp_path):
    refused = [
        (tmp_path / "nowhere", "no such results folder"),
        (tmp_path, "not a results folder"),
        (results.folder.parent, f"the newest below it is {results.folder}"),
        (results.report, "a file, not a results folder"),
    ]
    assert_refused([(partial(bojax.load, path), message) for path, message in refused], bojax.BojaxError)
