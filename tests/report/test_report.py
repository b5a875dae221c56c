import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from bojax.report.build import build_report
from bojax.report.figures import draw
from bojax.report.source import load
from bojax.report.verdicts import print_verdicts
from bojax.results.store import ResultsError
from tests.report.synthetic import BEHAVIOUR, edit_manifest, in_memory, set_column, write_results

DRAWN = ["accumulated-reward", "success", "returns", "paths"]


class Page(HTMLParser):
    """What a browser would find in the page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.loaded, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.loaded += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data):
        self.text += data

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_results(tmp_path_factory.mktemp("report") / "results", runs=40)
    assert build_report(folder) == folder / "report.html"
    return folder


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_page_names_every_planner_and_every_verdict_and_shows_the_numbers_of_the_tables(page, folder):
    for claim in json.loads((folder / "claims.json").read_text()):
        assert claim["id"] in page.text and claim["verdict"] in page.text
    for text in (
        *BEHAVIOUR,
        "Robot parking (Fig. 4.6)",
        "bojax sweep sweeps/parking.yaml --runs 40",
        "17.5 s of run time, 36.2 s of compilation",
        "97d835b, with uncommitted changes",
        "80.0%",  # 16 of 20 runs of kcbts park
        "75.0%",  # 15 of 20 runs of random leave the domain
        "12.3 ms",
        "7.25 s",
        "8,230",  # 12,345 steps in 1.5 s
    ):
        assert text in page.text


def test_the_caption_says_over_which_runs_the_mean_of_steps_to_success_is(page):
    assert "Steps to success: mean over the runs that succeeded." in page.text


def test_verdicts_are_printed(folder, capsys, tmp_path):
    claims = json.loads((folder / "claims.json").read_text())
    print_verdicts(folder)
    out, err = capsys.readouterr()
    *lines, counts = err.splitlines()
    assert out == "" and len(lines) == len(claims) == 7
    for claim, line in zip(claims, lines, strict=True):
        assert line.startswith(f"{claim['verdict']:<14}  {claim['id']}: {claim['claim']}")
    assert lines[-1].endswith("(no runs of cbts)")
    assert counts == f"{folder}: 7 claims: 3 reproduced, 2 not reproduced and 2 inconclusive"
    print_verdicts(folder, is_brief=True)
    assert capsys.readouterr().err.splitlines() == [counts]
    (tmp_path / "claims.json").write_text(json.dumps([claims[-1] | {"class": "variant"}]))
    print_verdicts(tmp_path)
    assert capsys.readouterr().err.splitlines()[0].endswith("(variant; no runs of cbts)")


def test_page_loads_nothing(page, folder):
    loaded = [address for address in page.loaded if not address.startswith("#")]  # places of the page
    assert loaded and all(address.startswith("data:image/svg+xml;base64,") for address in loaded)
    assert page.all("script") == [{}] and not page.all("link")
    text = (folder / "report.html").read_text()
    assert not re.search(r"url\(|@import|https?://", text)


def test_the_page_knows_the_names_of_curves_that_can_be_hidden(page, folder):
    listed = [json.loads(image["data-curves"]) for image in page.all("img") if "data-curves" in image]
    assert len(listed) == 2  # accumulated reward and success
    assert all(names == ["kcbts", "sbo-5", "sbo-9", "gps-abt", "random"] for names in listed)
    assert (folder / "report.html").read_text().count("img[data-curves]") == 1


def test_page_is_accessible(page):
    assert page.all("html") == [{"lang": "en"}]
    assert len(page.all("img")) == len(DRAWN)
    assert all(len(image["alt"]) > 40 for image in page.all("img"))
    assert all(header.get("scope") in ("row", "col") for header in page.all("th"))
    assert [name for name, _ in page.tags].count("h1") == 1


def test_text_of_the_sweep_is_escaped(folder):
    text = (folder / "report.html").read_text()
    assert "SBO &lt;parks&gt; in fewer" in text
    assert "Left open: &lt;what&gt; &amp; why." in text


def test_figures_are_written_as_png_and_svg_and_rebuilding_gives_the_same_bytes(folder):
    paths = [folder / "claims.json", folder / "report.html", *(folder / "figures").iterdir()]
    first = {path.name: path.read_bytes() for path in paths}
    names = {f"{name}.{suffix}" for name in DRAWN for suffix in ("png", "svg")}
    assert first.keys() == {*names, "claims.json", "report.html"} and first["paths.png"][:4] == b"\x89PNG"
    build_report(folder)
    assert {path.name: path.read_bytes() for path in paths} == first
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]


def test_report_settings_choose_figures_and_notes(blank_figures, tmp_path):
    report = {
        "figures": ["returns", "latency", "trajectories", "no-such-figure"],
        "notes": "First note.\n\nSecond note.",
        "thesis": {"sbo": {"success": "1 of 5"}},
        "by_step": 9,
    }
    folder = write_results(tmp_path / "results", runs=8, recorded=0, report=report)
    (folder / "figures").mkdir()
    (folder / "figures" / "success.png").write_bytes(b"of an earlier report")
    (folder / "figures" / "mine.png").write_bytes(b"of the user")
    build_report(folder)
    page = Page((folder / "report.html").read_text())
    assert {path.name for path in (folder / "figures").iterdir()} == {
        "returns.png",
        "returns.svg",
        "mine.png",
    }
    assert not page.all("script")  # without curves there is nothing to run
    assert "First note." in page.text and "Second note." in page.text
    assert "No figure is called no-such-figure" in page.text
    assert "The figure trajectories is not drawn: no trajectories in arrays/." in page.text
    assert page.text.count("thesis 1 of 5") == 2  # both variants of sbo
    assert "success by step 9" in page.text


def test_missing_runs_and_nans_are_said(blank_figures, tmp_path):
    folder = write_results(tmp_path / "results", runs=8, report={"figures": ["returns"]})
    failed = {"status": "failed", "runs": 10, "chunks": [{"error": None}, {"error": "out of memory"}]}
    edit_manifest(folder, lambda manifest: manifest.update(failed))
    index = np.arange(8 * 5)
    set_column(folder, "nans", np.where(index < 2, 3, 0))
    set_column(folder, "planned_return", np.where(index == 1, np.nan, 0.0))
    build_report(folder)
    text = Page((folder / "report.html").read_text()).text
    assert "Missing: 10 runs of kcbts, sbo-5, sbo-9, gps-abt and random" in text
    assert "out of memory" in text
    assert "Runs with a NaN: kcbts 2. In 1 run, what was learned became non-finite." in text
    set_column(folder, "return", np.where(index == 3, np.nan, 1.0))
    build_report(folder)
    assert "NaN in 1 run" in Page((folder / "report.html").read_text()).text
    assert "planned return" not in text  # a diagnosis of runs, not a result of points


def test_trajectories_are_drawn_one_panel_a_point(tmp_path):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    angle = np.linspace(-1, 1, 5)[:, None] * np.linspace(0, 1, 9)
    paths = np.stack([np.cos(angle), np.sin(angle), angle], axis=-1)
    for point in range(3):
        np.savez(folder / "arrays" / f"{point}-0-trajectories-end.npz", paths=paths)
    assert "kcbts, 5 paths; sbo-5, 5 paths; sbo-9, 5 paths" in draw("trajectories", load(folder)).alt


def test_many_points_are_drawn_by_the_best_of_each_label():
    swept = {f"{label} {kappa}": {"label": label, "kappa": kappa} for label in "abc" for kappa in range(5)}
    runs = {name: {"return": np.full(3, float(each["kappa"] == 2))} for name, each in swept.items()}
    drawing = draw("returns", in_memory(runs, swept=swept))
    assert "Of 15 points, the one with the best mean return of each label is drawn." in drawing.caption
    assert drawing.alt.endswith("Means: a 2 1.00, b 2 1.00, c 2 1.00.")


def test_unreadable_folders_end_in_one_line_and_nothing_is_written(blank_figures, tmp_path):
    snapshot = "arrays/0-0-paths-end.npz"
    for name, damage in {
        "runs.parquet": lambda folder: (folder / "runs.parquet").unlink(),
        snapshot: lambda folder: (folder / snapshot).write_bytes((folder / snapshot).read_bytes()[:900]),
        "figures": lambda folder: (folder / "figures").write_text("in the way"),
    }.items():
        folder = write_results(tmp_path / name.partition(".")[0], runs=2)
        damage(folder)
        with pytest.raises(ResultsError) as error:
            build_report(folder)
        assert "\n" not in str(error.value) and str(folder / name) in str(error.value)
        assert not (folder / "report.html").exists() and not (folder / "claims.json").exists()


def test_reports_are_made_without_jax_and_without_pyplot_and_import_a_figure_when_it_is_drawn(folder):
    code = (
        "import sys, pathlib; from bojax.report.build import build_report; "
        "from bojax.config.sweep import load_sweep; load_sweep('fig-4.6'); "
        "early = [name for name in sys.modules if name.startswith('bojax.report.figures.')]; "
        f"build_report(pathlib.Path({str(folder)!r})); "
        "print(early, [name for name in ('jax', 'equinox', 'matplotlib.pyplot') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] []"


def test_the_figure_and_the_table_come_before_the_claims_and_the_contents_lead_to_all(folder):
    page = (folder / "report.html").read_text()
    links = re.findall(r'href="#([\w-]+)"', page[: page.index("</nav>")])
    places = [page.index(f'id="{name}"') for name in links]
    assert places == sorted(places)
    assert links[0] == "figure" and links.index("outcomes") < links.index("claims") < links.index(
        "provenance"
    )
