"""A report is written whatever the names and the numbers of the results are, and says what it left out."""

import base64
import json
import warnings
from xml.etree import ElementTree

import numpy as np
import pytest

from bojax.cli.main import main
from bojax.report import progress, statistics, style
from bojax.report.build import build_report
from bojax.report.drawing.base import Drawing
from bojax.report.figures import draw
from bojax.report.source import load
from bojax.results.outline import Outline
from tests.report.synthetic import edit_manifest, set_column, write_results

ONE = {"figures": ["returns"]}
"""A report with a single figure, where the text is what matters."""


def sweep_a_number(manifest):
    for point in manifest["points"]:
        point["swept"] = {"planner.kappa": point["index"]}
        point["variant"] = point["label"]


def test_numbers_of_any_size_leave_a_page(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0)
    edit_manifest(folder, sweep_a_number)
    for value in (np.nan, np.inf, 1e300, -1e17):
        set_column(folder, "return", value)
        with np.errstate(all="ignore"):
            text = build_report(folder).read_text()
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

    monkeypatch.setattr("bojax.report.figures.returns.returns", fail)
    report = {"figures": ["returns", "success"]}
    folder = write_results(tmp_path / "results", runs=2, recorded=0, report=report)
    text = build_report(folder).read_text()
    assert "The figure returns could not be drawn: ZeroDivisionError: of my own." in text
    assert (folder / "figures" / "success.png").exists() and not (folder / "figures" / "returns.png").exists()


def test_an_exception_in_a_test_leaves_its_claim_open(blank_figures, tmp_path, monkeypatch):
    def fail(results, test):
        raise ZeroDivisionError("of my own")

    monkeypatch.setattr("bojax.claims.means.share", fail)
    folder = write_results(tmp_path / "results", runs=20, recorded=0, report=ONE)
    build_report(folder)
    found = {claim["id"]: claim for claim in json.loads((folder / "claims.json").read_text())}
    assert found["share-holds"]["verdict"] == "inconclusive"
    assert found["share-holds"]["test"]["reason"] == "the test failed: ZeroDivisionError: of my own"
    assert found["order-holds"]["verdict"] == "reproduced"


def test_names_are_drawn_as_they_are(tmp_path):
    folder = write_results(tmp_path / "results", runs=8, recorded=1)
    names = [r"$\unknowncmd$", "$", "a_b^{", "&<b>\nbreak\t\x07", "\ud800x"]
    edit_manifest(folder, lambda m: [p.update(variant=v) for p, v in zip(m["points"], names, strict=True)])
    edit_manifest(folder, lambda manifest: manifest.update(title=" ".join(names)))
    text = build_report(folder).read_text(encoding="utf-8")
    assert "could not be drawn" not in text
    assert {"returns.png", "paths.png"} <= {path.name for path in (folder / "figures").iterdir()}


@pytest.mark.parametrize("has_font", [True, False])
def test_a_name_in_chinese_is_drawn_without_warnings(tmp_path, monkeypatch, has_font):
    if not has_font:
        monkeypatch.setattr(style, "_FALLBACKS", ())
    folder = write_results(tmp_path / "results", runs=8, recorded=0, report=ONE)
    edit_manifest(folder, lambda manifest: manifest["points"][0].update(variant="停车"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = build_report(folder).read_text(encoding="utf-8")
    if not has_font:  # whether one is installed depends on the machine
        assert text.count("Figures show some characters of names as boxes") == 1


def test_other_warnings_of_a_figure_are_shown(tmp_path, monkeypatch):
    def warn(results):
        warnings.warn("something else", stacklevel=2)
        return Drawing(style.figure(1.0)[0], "title", "caption", "alternative text of the figure")

    monkeypatch.setattr("bojax.report.figures.returns.returns", warn)
    folder = write_results(tmp_path / "results", runs=2, recorded=0, report=ONE)
    with pytest.warns(UserWarning, match="something else"):
        build_report(folder)


def test_changed_settings_are_told_at_the_top_and_with_every_verdict(blank_figures, tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0, report=ONE)
    changed = {"planner.iterations": [300, 20], "problem.vehicle": [None, {"kind": "wheeled-robot"}]}
    edit_manifest(folder, lambda manifest: manifest.update(changed=changed))
    text = build_report(folder).read_text()
    verdicts = json.loads((folder / "claims.json").read_text())
    assert all(claim["changed"] == changed for claim in verdicts)
    assert text.index("planner.iterations") < text.index('<h2 id="claims">')
    assert "<td>300</td><td>20</td>" in text and "<td>none</td><td>kind wheeled-robot</td>" in text
    assert text.count('<a href="#changed">settings changed</a>') == len(verdicts)
    edit_manifest(folder, lambda manifest: manifest.pop("changed"))
    text = build_report(folder).read_text()
    assert "Settings changed" not in text and "settings changed" not in text
    assert all(claim["changed"] == {} for claim in json.loads((folder / "claims.json").read_text()))


def test_a_label_is_not_said_to_stand_for_itself(blank_figures, tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=0, report=ONE)
    edit_manifest(folder, lambda manifest: manifest["points"][2].update(variant="sbo", swept={}))
    text = build_report(folder).read_text()
    assert "sbo is represented by sbo" not in text and "variant with the" not in text


def test_without_latencies_the_page_does_not_speak_of_them(blank_figures, tmp_path):
    folder = write_results(tmp_path / "results", runs=4, recorded=0, report=ONE)
    text = build_report(folder).read_text()
    assert "Latency and throughput" in text and "latency at batch 1" in text
    (folder / "latency.json").unlink()
    text = build_report(folder).read_text()
    assert "Throughput" in text and "atency" not in text


def test_plates_are_dark_on_a_dark_page(tmp_path):
    folder = write_results(tmp_path / "results", runs=4, recorded=0, report=ONE)
    page = build_report(folder).read_text()
    code = page.partition("data:image/svg+xml;base64,")[2].partition('"')[0]
    drawn = base64.b64decode(code).decode()
    assert "<style>@media (prefers-color-scheme: dark){#patch_1 path{fill:" in drawn
    assert f'[style*="stroke: {style.INK}"]' in drawn and f"stroke: {style.INK}" in drawn
    ElementTree.fromstring(drawn)
    assert "prefers-color-scheme" not in (folder / "figures" / "returns.svg").read_text()


def test_lines_on_maps_keep_their_colours():
    figure, grid = style.figure(1.0)
    grid[0, 0].imshow(np.eye(3))
    with style.settings():
        drawn = style.adapted(style.encode(figure)["svg"]).decode()
    assert f'[style*="stroke: {style.INK}"]' not in drawn.replace("[id^=text_] [style", "")


def test_the_summary_says_the_limit_of_an_episode_and_a_gallery_counts_no_nans(blank_figures, tmp_path):
    folder = write_results(tmp_path / "results", runs=4, recorded=0, report=ONE)
    edit_manifest(folder, lambda m: [p["config"]["problem"].update(max_steps=40) for p in m["points"]])
    assert "4 runs each of up to 40 steps" in build_report(folder).read_text()
    edit_manifest(folder, lambda m: [p.update(config={"kind": "trajectories"}) for p in m["points"]])
    assert "runs with NaN" not in build_report(folder).read_text()


def drawn_labels(folder):
    results = load(folder)
    with style.settings():
        figure = draw("paths", results).figure
    return [text.get_text() for text in figure.legends[0].get_texts()], figure.axes[0].patches


def test_an_outline_is_drawn_and_the_legend_lists_what_is_drawn(tmp_path):
    folder = write_results(tmp_path / "results", runs=8, recorded=8)
    outline = {"border": [-4, -4, 4, 4], "obstacles": [[1, 1, 0.5], [0, 0, 1, 2]], "goals": [[2, 2, 0.3]]}

    def declare(manifest):
        for point in manifest["points"]:
            point["config"]["problem"]["kind"] = "mine:Dock"
            point["outline"] = outline

    edit_manifest(folder, declare)
    labels, patches = drawn_labels(folder)
    assert labels == ["success", "failure", "start", "obstacle", "goal"] and len(patches) == 5
    edit_manifest(folder, lambda m: [point.pop("outline") for point in m["points"]])
    labels, patches = drawn_labels(folder)
    assert labels == ["success", "failure", "start"] and not patches


def test_outlines_are_plain_numbers():
    outline = Outline(border=np.array([0, 0, 1, 1]), goals=[(0.0, np.float32(2.0), np.array(0.5))])
    assert outline.as_numbers() == {
        "border": [0.0, 0.0, 1.0, 1.0],
        "obstacles": [],
        "goals": [[0.0, 2.0, 0.5]],
        "start": None,
        "heading": None,
        "blocks": [],
    }
    with pytest.raises(ValueError, match="obstacles: got .* allowed: 3 or 4 finite numbers"):
        Outline(obstacles=[(1.0, np.nan, 0.5)]).as_numbers()


def test_the_intervals_hide_no_dots(tmp_path):
    results = load(write_results(tmp_path / "results", runs=40, recorded=0))
    axes = draw("returns", results).figure.axes[0]
    bars = [line.get_ydata()[0] for line in axes.lines]
    dots = [points.get_offsets()[:, 1] for points in axes.collections[::2]]
    for row, (bar, heights) in enumerate(zip(bars, dots, strict=True)):
        assert heights.max() + 0.1 < bar < row + 0.6


def test_what_is_no_results_folder_is_told_in_a_line(tmp_path, refusal):
    for name in ("nowhere", "x" * 5000, "a" * 100 + "/" + "b" * 300):
        error = refusal(f"report {tmp_path}/{name}")
        assert "no such results folder" in error and len(error) < 400
    (tmp_path / "file").write_text("")
    assert refusal(f"report {tmp_path}/file") == f"{tmp_path}/file: a file, not a results folder"
    for above, below in (("one", "1"), ("two", "parking/1")):
        folder = tmp_path / above / below
        folder.parent.mkdir(parents=True)
        write_results(folder, runs=2, recorded=0)
        told = f"{tmp_path}/{above}: not a results folder; the newest below it is {folder}"
        assert refusal(f"report {tmp_path}/{above}") == told
    (tmp_path / "two" / "tuning.json").write_text("{}")  # as a search leaves it beside its rounds
    assert f"{tmp_path}/two/best.yaml" in refusal(f"best {tmp_path}/two")


@pytest.mark.parametrize(("patience", "lines"), [(0.0, 1), (1e9, 0)])
def test_a_slow_report_says_one_line_where_there_is_no_terminal(
    blank_figures, tmp_path, capsys, monkeypatch, patience, lines
):
    monkeypatch.setattr(progress, "PATIENCE", patience)
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    assert main(["report", str(folder)]) == 0
    out, error = capsys.readouterr()
    progress_lines = [line for line in error.splitlines() if line.startswith("writing")]
    assert out == f"{folder}/report.html\n"
    assert progress_lines == [f"writing the report of {folder} ..."] * lines


def test_many_runs_are_told_to_be_resampled_in_groups(blank_figures, tmp_path, monkeypatch):
    monkeypatch.setattr(statistics, "GROUPS", 10)
    monkeypatch.setattr(statistics, "FEW", 20)
    folder = write_results(tmp_path / "results", runs=20, recorded=0, report=ONE)
    text = build_report(folder).read_text()
    assert "The bootstrap resamples 10 groups into which 20 runs were dealt." in text
    claim = json.loads((folder / "claims.json").read_text())[0]
    assert claim["test"]["method"].count("10,000 resamples of 10 groups into which 20 runs were dealt") == 1
