"""Names from files in figures: none has a meaning to Matplotlib, and each stands at its own curve."""

import csv
import json
import warnings
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

from bojax.report import style
from bojax.report.comparing.build import compare
from bojax.report.comparing.methods import Options
from bojax.report.drawing.base import dot_plot, name_panels, panel_grid
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.figures import draw
from bojax.report.source import load
from bojax.report.text import distinct, file_name, number, printed, shortened
from tests.report.synthetic import edit_manifest, in_memory, point_of, write_learning
from tests.report.test_report import Page

NAMES = {
    "_baseline": "_baseline",
    "_": "_",
    "$x_1$": "$x_1$",
    r"\frac{$a": r"\frac{$a",
    "two\nlines": "two lines",
    "two lines": "two lines (2)",
    "": "(no name)",
    "\u200d ": "(no name) (2)",
    "nul\0, bell\a and\x0bmore": "nul, bell and more",
    "n" * 300: "n" * 300,
    "n" * 149 + "m" + "n" * 150: "n" * 149 + "m" + "n" * 150,
    "\u05e9\u05dc\u05d5\u05dd 12": "\u05e9\u05dc\u05d5\u05dd 12",
    "\u0645\u0631\u062d\u0628\u0627": "\u0645\u0631\u062d\u0628\u0627",
    "\u202egnirts": "gnirts",
    "\ud800 half": "\N{REPLACEMENT CHARACTER} half",
    "-- {0} %s <b>&amp;": "-- {0} %s <b>&amp;",
    "na\u00efve \U0001f600": "na\u00efve \U0001f600",
}
"""Names as a file may have them, and as figures and pages have them."""


def curves_of(names):
    """Curves of three places, one above the other."""
    points = [point_of(place, name, name) for place, name in enumerate(names)]
    return [Curve(point, np.arange(3.0), np.full((2, 3), float(place))) for place, point in enumerate(points)]


def texts_of(figure):
    return [each for each in figure.findobj(Text) if each.get_text()]


def encoded(figure):
    """Files of a figure, without a warning but of glyphs; its SVG is well-formed."""
    with warnings.catch_warnings(), style.settings():
        warnings.simplefilter("error")
        warnings.filterwarnings("always", message=style._NO_GLYPH)
        files = style.encode(figure)
    ElementTree.fromstring(files["svg"])
    assert not any(text.get_parse_math() for text in texts_of(figure))
    return files


def test_a_name_is_one_line_of_visible_characters():
    assert distinct(map(printed, NAMES)) == list(NAMES.values())


def test_equal_names_are_numbered():
    assert distinct(["a", "a", "a (2)", "a"]) == ["a", "a (2)", "a (2) (2)", "a (3)"]


def test_a_long_text_loses_its_middle():
    assert shortened("a" * 48, 48) == "a" * 48
    assert shortened("abc" + "x" * 300 + "def", 9) == "abcx\N{HORIZONTAL ELLIPSIS}xdef"
    assert len(shortened("\u4e2d" * 100, 9)) == 5  # twice as wide as letters


def test_a_long_file_name_is_cut_and_stays_different():
    first, second = file_name("n" * 300 + "a"), file_name("n" * 300 + "b")
    assert first != second and len(first) == len(second) == 120
    assert len(file_name("\u4e2d" * 200).encode()) <= 120 and file_name("a/b c") == "a-b-c"


class TestChart:
    def test_each_entry_of_a_legend_stands_at_its_own_curve(self):
        with style.settings():
            chart = Chart([Panel("return", "mean return", curves_of(NAMES))], "episode")
            drawn = chart.drawing("Title")
        (legend,), lines = drawn.figure.legends, chart.axes[0].get_lines()
        expected = style.drawn_names([point_of(0, name, name) for name in NAMES])
        short = [name for name in expected if "\N{HORIZONTAL ELLIPSIS}" not in name]
        assert short == [name for name in NAMES.values() if len(name) < 48]
        for place, text in enumerate(legend.get_texts()):
            entry, line = legend.legend_handles[place], lines[place]
            assert text.get_text() == expected[place] and line.get_ydata()[0] == place
            looks = [(to_hex(each.get_color()), each.get_linestyle()) for each in (entry, line)]
            assert looks[0] == looks[1]
        encoded(drawn.figure)
        width = drawn.figure.bbox.width
        boxes = [text.get_window_extent() for text in legend.get_texts()]
        assert all(0 <= box.x0 and box.x1 <= width for box in boxes)
        assert not any(a.overlaps(b) for place, a in enumerate(boxes) for b in boxes[:place])

    @pytest.mark.parametrize("name", [name for name in NAMES if len(name) < 15])
    def test_a_short_name_stands_beside_its_curve(self, name):
        with style.settings():
            drawn = Chart([Panel("return", "mean return", curves_of([name, "other"]))], "x").drawing("Title")
        texts = {text.get_gid(): text for text in drawn.figure.axes[0].texts}
        assert texts["name-0-text"].get_text() == printed(name)
        assert texts["name-1-text"].get_text() == "other"
        encoded(drawn.figure)

    def test_words_of_axes_are_from_files_too(self):
        label = "$" + "score\n" * 100
        with style.settings():
            drawn = Chart([Panel(label, "mean", curves_of("ab"))], "_x\n$").drawing("Title")
        axes = drawn.figure.axes[0]
        assert axes.get_xlabel() == "_x $" and len(axes.get_ylabel()) <= style.LONGEST
        encoded(drawn.figure)


def test_rows_and_panels_are_named_in_order():
    points = [curve.point for curve in curves_of(NAMES)]
    with style.settings():
        rows, grid = dot_plot(points, 1, 1, ticks=2)
        panels, axes = panel_grid(len(points), lambda columns: 1.0, 0.2)
        name_panels(axes.flat, points)
    rows.set_size_inches(4.7, 20)
    expected = [name.split() for name in style.drawn_names(points)]
    assert [label.get_text().split() for label in grid[0, 0].get_yticklabels()][:8] == expected[:8]
    assert [each.get_title().split() for each in axes.flat][:8] == expected[:8]
    encoded(rows)


def test_the_legend_of_settings_is_in_the_order_of_its_curves():
    labels = ["_first", "$second$", "third\nline", "fourth"]
    names = [f"{label} {value}" for label in labels for value in (1, 2)]
    results = in_memory(
        {name: {"return": np.full(3, float(place))} for place, name in enumerate(names)},
        swept={name: {"label": name[:-2], "planner.depth": int(name[-1])} for name in names},
    )
    with style.settings():
        drawing = draw("settings", results)
    (legend,), lines = drawing.figure.legends, drawing.figure.axes[0].get_lines()[::2]
    entries = list(zip(legend.legend_handles, legend.get_texts(), strict=True))
    assert [text.get_text() for _, text in entries] == ["_first", "$second$", "third line", "fourth"]
    assert [line.get_color() for line, _ in entries] == [line.get_color() for line in lines]
    encoded(drawing.figure)


def test_a_comparison_keeps_every_name_at_its_curve(tmp_path):
    """All names in one CSV file: the page, its figures and their alternative texts."""
    path = tmp_path / "curves.csv"
    labels = [name for name in NAMES if printed(name) == name or "\n" in name]
    rows = [
        (label, run, x, place) for place, label in enumerate(labels[:11]) for run in (0, 1) for x in (1, 2)
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("label", "run", "x", "value"), *rows])
    page = Page(
        compare([], [path], tmp_path / "out", Options(reference="_baseline")).read_text(encoding="utf-8")
    )
    image = next(each for each in page.all("img") if "data-curves" in each)
    names = json.loads(image["data-curves"])
    assert names == distinct(map(printed, labels[:11]))
    for place, name in enumerate(names):
        assert f"{name} {number(place)} and {number(place)}" in image["alt"]
    assert len(list((tmp_path / "out" / "figures").iterdir())) == 4


def test_names_of_points_are_different_and_visible_when_results_are_read(tmp_path):
    folder = write_learning(tmp_path / "car", runs=2)

    def rename(manifest):
        for point, name in zip(manifest["points"], ("_a\nb", "_a b", "\u202e"), strict=True):
            point["variant"] = name

    edit_manifest(folder, rename)
    assert [point.name for point in load(folder).points] == ["_a b", "_a b (2)", "(no name)"]
