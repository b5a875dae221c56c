"""A report is written whatever the names and the numbers of the results are, and says what it left out."""

import json
import warnings

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bojax.report import claims, style
from bojax.report.build import build_report
from bojax.report.figures import FIGURES
from bojax.report.figures.base import Drawing
from tests.report.synthetic import edit_manifest, write_results


def set_returns(folder, value):
    table = pq.read_table(folder / "runs.parquet")
    values = pa.array(np.full(table.num_rows, value))
    table = table.set_column(table.column_names.index("return"), "return", values)
    pq.write_table(table, folder / "runs.parquet")


def sweep_a_number(manifest):
    for point in manifest["points"]:
        point["swept"] = {"planner.kappa": point["index"]}
        point["variant"] = point["label"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1e17])
def test_numbers_of_any_size_leave_a_page(tmp_path, value):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    set_returns(folder, value)
    edit_manifest(folder, sweep_a_number)
    with np.errstate(all="ignore"):
        text = build_report([folder]).read_text()
    assert "could not be drawn" not in text
    names = {path.name for path in (folder / "figures").iterdir()}
    assert ("returns.png" in names) == bool(np.isfinite(value))
    assert "settings.png" in names or not np.isfinite(value)


def test_equal_returns_stand_where_they_are():
    from bojax.report.figures.returns import swarm

    dots, offsets = swarm(np.full(5, 1e300), np.linspace(1e300, 1e300, 91))
    np.testing.assert_array_equal(dots, 1e300)
    assert np.unique(offsets).size == 5


def test_an_exception_in_a_figure_is_a_note(tmp_path, monkeypatch):
    def fail(results):
        raise ZeroDivisionError("of my own")

    monkeypatch.setitem(FIGURES, "returns", fail)
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    text = build_report([folder]).read_text()
    assert "The figure returns could not be drawn: ZeroDivisionError: of my own." in text
    assert (folder / "figures" / "success.png").exists() and not (folder / "figures" / "returns.png").exists()


def test_an_exception_in_a_test_leaves_its_claim_open(tmp_path, monkeypatch):
    def fail(results, test):
        raise ZeroDivisionError("of my own")

    monkeypatch.setitem(claims.TESTS, "share", fail)
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    build_report([folder])
    found = {claim["id"]: claim for claim in json.loads((folder / "claims.json").read_text())}
    assert found["share-holds"]["verdict"] == "inconclusive"
    assert found["share-holds"]["test"]["reason"] == "the test failed: ZeroDivisionError: of my own"
    assert found["order-holds"]["verdict"] == "reproduced"


def test_a_claim_with_a_margin_of_text_is_inconclusive(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    edit_manifest(folder, lambda manifest: manifest["claims"][0]["test"].update(margin="wide"))
    build_report([folder])
    claim = json.loads((folder / "claims.json").read_text())[0]
    assert claim["verdict"] == "inconclusive" and "the test failed: ValueError" in claim["test"]["reason"]


@pytest.mark.parametrize(
    "name", [r"$\unknowncmd$", "$", "a_b^{", "&<b>", "line\nbreak", "tab\t\x07", "\ud800x"]
)
def test_names_are_drawn_as_they_are(tmp_path, name):
    folder = write_results(tmp_path / "results", runs=8, recorded=1)

    def rename(manifest):
        manifest["title"] = name
        manifest["points"][0]["variant"] = name

    edit_manifest(folder, rename)
    text = build_report([folder]).read_text(encoding="utf-8")
    assert "could not be drawn" not in text
    assert {"returns.png", "paths.png"} <= {path.name for path in (folder / "figures").iterdir()}


@pytest.mark.parametrize("has_font", [True, False])
def test_a_name_in_chinese_is_drawn_without_warnings(tmp_path, monkeypatch, has_font):
    if not has_font:
        monkeypatch.setattr(style, "_FALLBACKS", ())
    folder = write_results(tmp_path / "results", runs=8, recorded=0, report={"figures": ["returns"]})
    edit_manifest(folder, lambda manifest: manifest["points"][0].update(variant="停车"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = build_report([folder]).read_text(encoding="utf-8")
    if not has_font:  # whether one is installed depends on the machine
        assert text.count("Some characters of the names stand as boxes in the figures") == 1


def test_other_warnings_of_a_figure_are_shown(tmp_path, monkeypatch):
    def warn(results):
        warnings.warn("something else", stacklevel=2)
        return Drawing(style.figure(1.0)[0], "title", "caption", "alternative text of the figure")

    monkeypatch.setitem(FIGURES, "returns", warn)
    folder = write_results(tmp_path / "results", runs=2, recorded=0, report={"figures": ["returns"]})
    with pytest.warns(UserWarning, match="something else"):
        build_report([folder])


def test_changed_settings_are_told_at_the_top_and_with_every_verdict(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    changed = {"planner.iterations": [300, 20], "problem.vehicle": [None, {"kind": "wheeled-robot"}]}
    edit_manifest(folder, lambda manifest: manifest.update(changed=changed))
    text = build_report([folder]).read_text()
    verdicts = json.loads((folder / "claims.json").read_text())
    assert all(claim["changed"] == changed for claim in verdicts)
    assert text.index("planner.iterations") < text.index("Claims of the thesis")
    assert "<td>300</td><td>20</td>" in text and "<td>none</td><td>kind wheeled-robot</td>" in text
    assert text.count('<a href="#changed">settings changed</a>') == len(verdicts)


def test_a_sweep_as_shipped_has_no_such_box(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    text = build_report([folder]).read_text()
    assert "Settings changed" not in text and "settings changed" not in text
    assert all(claim["changed"] == {} for claim in json.loads((folder / "claims.json").read_text()))


def test_a_label_is_not_said_to_stand_for_itself(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)

    def rename(manifest):
        manifest["points"][1]["variant"] = manifest["points"][2]["variant"] = "sbo"
        manifest["points"][1]["swept"] = manifest["points"][2]["swept"] = {}

    edit_manifest(folder, rename)
    text = build_report([folder]).read_text()
    assert "sbo stands for sbo" not in text
    assert "variant with the best mean" not in text
