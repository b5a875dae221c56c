"""The pages over several results folders: every claim with its verdict, in the order of the thesis."""

import json
import re
import subprocess
import sys

from bojax.claims.reproduction import reproduction
from bojax.config.sweep_file import published_report
from bojax.report.build import build_report
from bojax.results.store import ResultsError
from tests.refusals import one_line
from tests.report.synthetic import edit_manifest, write_results
from tests.report.test_report import Page

COMMAND = "bojax reproduce all --runs 200"

MANIFEST = {
    "status": "finished",
    "title": "Title",
    "runs": 200,
    "points": [{"index": 0, "label": "a"}, {"index": 1, "label": "b"}],
    "groups": [{"compile_seconds": 7.25, "run_seconds": 1.5}, {"compile_seconds": 0.75, "run_seconds": None}],
    "command": COMMAND,
    "written": "2026-01-02T10:01:35+0000",
    "versions": {"python": "3.12.3", "jax": "0.11.2"},
    "git": {"revision": "97d835b", "has_changes": False},
    "device": {"platform": "gpu", "kind": "NVIDIA H200", "count": 1, "driver": None},
}


def claim(name, source, verdict="reproduced", **changes):
    """A share of 80%, as `claims.json` has it."""
    test = {
        "kind": "share",
        "comparisons": [{"of": "share of a with success", "estimate": 0.8, "interval": [0.74, 0.85]}],
    }
    entry = {"id": name, "source": source, "claim": f"statement {name}", "thesis": 0.75, "changed": {}}
    entry |= {"ours": 0.8, "interval": [0.74, 0.85], "runs": 200, "verdict": verdict, "test": test}
    return {**entry, **changes}


def write(folder, claims, **changes):
    """A results folder of which only the manifest, the claims and the report are there."""
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text(json.dumps({**MANIFEST, "name": folder.name, **changes}))
    (folder / "claims.json").write_text(json.dumps(claims))
    (folder / "report.html").write_text("its report")
    return folder


def pages(folder, sources, **options):
    """The page as a browser finds it, and the text."""
    path = reproduction(folder, sources, 1533.0, **options)
    assert path == folder / "reproduction.html"
    return Page(path.read_text(encoding="utf-8")), (folder / "reproduction.md").read_text(encoding="utf-8")


def chapter(folder, file):
    """The page of a chapter as a browser finds it, and its text."""
    below = folder / "reproduction"
    html, text = (below / f"{file}.{suffix}" for suffix in ("html", "md"))
    return Page(html.read_text(encoding="utf-8")), text.read_text(encoding="utf-8")


def part(text, title):
    """What stands below a heading of a chapter, without the next place."""
    return text.split(f"### {title}\n")[1].split("\n<a id")[0].strip()


def cells(text, start):
    """Cells of the row of a Markdown table that contains a text."""
    (row,) = [line for line in text.splitlines() if start in line and line.startswith("|")]
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]]


def test_claims_are_counted_and_shown_beside_the_thesis(tmp_path):
    order = {
        "kind": "order",
        "comparisons": [
            {"of": "a - b", "estimate": 12.0, "interval": [3.0, 21.0]},
            {"of": "b - c", "estimate": 1.0, "interval": [-2.0, 4.0]},
        ],
    }
    claims = [
        claim("fig-4.6/share", "Fig. 4.6, p. 99-100 of the PDF"),
        claim(
            "fig-4.6/order",
            "Fig. 4.6, p. 100 of the PDF",
            "inconclusive",
            thesis="a > b > c",
            ours="a 20 > b 8 > c 7",
            interval=[-2.0, 4.0],
            test=order,
        ),
        claim("fig-4.6/fails", "Fig. 4.6, p. 100 of the PDF", "not reproduced"),
    ]
    page, text = pages(tmp_path, [write(tmp_path / "fig-4.6", claims)])
    sentence = (
        "3 claims, tested by 1 sweep: 1 reproduced, 1 not reproduced and 1 inconclusive; 0 of them rest on"
    )
    assert sentence in page.text and sentence in text
    assert cells(text, "statement fig-4.6/share") == [
        "Fig. 4.6, p. 99-100",
        "[statement fig-4.6/share](reproduction/chapter4.md#fig-4-6-share)",
        "reproduced",
        "0.75",
        "80.0% [74.0%, 85.0%]",
        "",
    ]
    here = cells(text, "statement fig-4.6/order")[4]
    assert here == "a 20 > b 8 > c 7 (b \N{MINUS SIGN} c 1.0 [\N{MINUS SIGN}2.0, 4.0])"
    assert cells(text, "statement fig-4.6/fails")[2] == "**not reproduced**"
    of_chapter, its_text = chapter(tmp_path, "chapter4")
    for said in ("80.0%", "[74.0%, 85.0%]", "99-100", "a 20 > b 8 > c 7", "Chapter 4: Sequential planning"):
        assert said in page.text and said in of_chapter.text
    assert part(its_text, "statement fig-4.6/order").splitlines()[:5] == [
        "- verdict: inconclusive",
        "- thesis: a > b > c",
        "- here: a 20 > b 8 > c 7",
        "- a \N{MINUS SIGN} b 12.0 [3.0, 21.0]",
        "- b \N{MINUS SIGN} c 1.0 [\N{MINUS SIGN}2.0, 4.0]",
    ]


def test_variants_and_checks_are_shown_apart_and_not_counted(tmp_path):
    why = {"claims": ["v", "a"], "cause": "slip", "text": "It is so."}
    share = {"share": 0.25, "configurations": 320}
    claims = [
        claim("a", "Fig. 3.1, p. 72", "not reproduced", own_bound=True, **share),
        claim("v", "Fig. 3.1, p. 72", "not reproduced", **{"class": "variant"}),
        claim("k", "Fig. 3.1, p. 72", **{"class": "check"}),
        claim("b", "Fig. 3.3, p. 74"),
    ]
    page, text = pages(tmp_path, [write(tmp_path / "mine", claims, report={"explanations": [why]})])
    sentence = (
        "2 claims, tested by 1 sweep: 1 reproduced, 1 not reproduced and 0 inconclusive; 1 of them rest on"
    )
    assert sentence in text and "Causes of the 1 not reproduced: 1 a slip" in text
    assert "Variants and checks, 2 in all," in text and "`holds in`" in text
    assert "statement v" not in text + page.text and "statement k" not in text + page.text
    assert cells(text, "statement a")[2::3] == ["**not reproduced** \N{DAGGER}", "25.0% of 320"]
    assert cells(text, "| `mine` | 2 ")[3] == cells(text, "| all |")[3] == "2"
    of_chapter, its_text = chapter(tmp_path, "chapter3")
    assert "1 reproduced, 1 not reproduced and 0 inconclusive." in its_text
    first = its_text.split("## Fig. 3.3")[0]
    assert first.index("### statement a") < first.index("Variants and checks") < first.index("| statement v")
    assert cells(its_text, "| statement k")[1] == "check" and "### statement v" not in its_text
    told = part(its_text, "statement a")
    assert "- why: a slip of the thesis. It is so." in told and "- holds in: 25.0% of 320" in told
    assert its_text.count("It is so.") == of_chapter.text.count("It is so.") == 1


def test_each_link_of_the_pages_leads_to_a_place(tmp_path):
    sources = ("Fig. 5.4 (top), p. 1", "Table 5.1", None, "the author's code")
    claims = [claim(f"c/{number}", source, "inconclusive") for number, source in enumerate(sources)]
    folders = [write(tmp_path / name, claims) for name in ("c", "table-5.3-x")]
    pages(tmp_path, folders)
    below = tmp_path / "reproduction"
    assert {path.name for path in below.iterdir()} == {
        f"{file}.{suffix}" for file in ("chapter5", "other") for suffix in ("html", "md")
    }
    for suffix, pattern in (("md", r"\]\(([^)]*)\)"), ("html", r'href="([^"]*)"')):
        for path in (tmp_path / f"reproduction.{suffix}", *below.glob(f"*.{suffix}")):
            targets = re.findall(pattern, path.read_text())
            assert len(targets) > 1
            for target in targets:
                file, _, anchor = target.partition("#")
                linked = (path.parent / file if file else path).read_text()
                assert not anchor or f'id="{anchor}"' in linked, (path.name, target)


def test_claims_are_in_the_order_of_the_thesis(tmp_path):
    sources = [
        "Fig. 5.8b, p. 138 of the PDF",
        "Table 5.1, p. 123 of the PDF",
        "Fig. 5.4 (top), p. 123-124 of the PDF",
        "Section 4.7.1, p. 98 of the PDF",
        "Fig. 4.10, p. 97 of the PDF",
        "Fig. 4.4, p. 97 of the PDF",
        "Fig. 5.2 and text, p. 120 of the PDF",
        "Fig. 5.2a, p. 119-120 of the PDF",
    ]
    claims = [claim(f"c{number}", source) for number, source in enumerate(sources)]
    folders = [write(tmp_path / "z", claims[:4]), write(tmp_path / "y", claims[4:])]
    page, text = pages(tmp_path, folders)
    order = [5, 4, 3, 6, 7, 2, 0, 1]
    assert re.findall(r"statement c(\d)", text) == [str(number) for number in order]
    assert re.findall(r"statement c(\d)", page.text) == [str(number) for number in order]
    assert "Fig. 5.4 (top)" in page.text and page.text.index("Chapter 4") < page.text.index("Chapter 5")


def test_claims_of_other_sources_stand_with_their_figure(tmp_path):
    code = claim("table-5.3-mountain-car/published", "the author's <code>")
    alone = claim("mine", None)
    page, text = pages(tmp_path, [write(tmp_path / "mine", [alone, code])])
    assert "Table 5.3" in page.text and "the author's <code>" in page.text
    assert "source: the author's &lt;code>; sweep: `mine`" in chapter(tmp_path, "chapter5")[1]
    assert cells(text, "statement table-5.3")[0] == "the author's &lt;code>"
    assert text.index("Chapter 5") < text.index("Other claims") < text.index("statement mine")


def test_changed_settings_are_marked_and_listed(tmp_path):
    changed = {"planner.iterations": [300, 50]}
    folders = [
        write(tmp_path / "fig-3.1", [claim("a", "Fig. 3.1", changed=changed)], changed=changed),
        write(tmp_path / "fig-3.3", [claim("b", "Fig. 3.3", changed=changed)], changed=changed),
        write(tmp_path / "fig-3.5", [claim("c", "Fig. 3.5")]),
    ]
    page, text = pages(tmp_path, folders)
    assert "2 claims were tested with changed settings." in text
    assert [cells(text, f"statement {name}")[2] for name in "abc"] == [
        *("reproduced, changed", "reproduced, changed", "reproduced")
    ]
    assert cells(text, "planner.iterations") == ["`planner.iterations`", "300", "50", "fig-3.1 and fig-3.3"]
    assert page.text.count("changed") > 3 and page.loaded.count("#changed") == 2


def test_links_lead_to_the_reports_and_nothing_is_loaded(tmp_path):
    folders = [
        write(tmp_path / "results" / "fig 4.6" / "now", [claim("a", "Fig. 4.6")], name="fig-4.6"),
        write(tmp_path / "results" / "fig-4.4", [claim("b", "Fig. 4.4")]),
    ]
    (folders[1] / "report.html").unlink()
    page, text = pages(tmp_path / "all", folders)
    address = "../results/fig%204.6/now/report.html"
    of_chapter, its_text = chapter(tmp_path / "all", "chapter4")
    assert address in page.loaded and f"../{address}" in of_chapter.loaded
    assert (tmp_path / "all" / "reproduction" / ".." / address.replace("%20", " ")).exists()
    for path in ("reproduction.html", "reproduction/chapter4.html"):
        html = (tmp_path / "all" / path).read_text()
        assert "<script" not in html and not re.search(r"url\(|@import|https?://", html)
    # A copy of the text elsewhere has no broken links.
    assert "report.html" not in text + its_text


def test_the_machine_the_time_and_the_command_are_said(tmp_path):
    other: dict = {"device": {"platform": "cpu", "kind": "cpu", "count": 2}}
    other |= {"written": "2026-01-03T00:00:00+0000", "command": "bojax sweep fig-3.3"}
    folders = [
        write(tmp_path / "fig-3.1", [claim("a", "Fig. 3.1")]),
        write(tmp_path / "fig-3.3", [claim("b", "Fig. 3.3")], **other),
    ]
    page, text = pages(tmp_path, folders)
    assert cells(text, "| command 1") == ["command 1", f"`{COMMAND}`"]
    assert cells(text, "| command 2") == ["command 2", "`bojax sweep fig-3.3`"]
    assert cells(text, "time taken")[1] == "25 min 33 s"
    assert cells(text, "last sweep written")[1] == "2026-01-03T00:00:00+0000"
    assert cells(text, "| revision")[1] == "97d835b"
    assert cells(text, "| versions")[1] == "python 3.12.3, jax 0.11.2"
    gpu, cpu = "platform gpu, kind NVIDIA H200, count 1", "platform cpu, kind cpu, count 2"
    assert cells(text, "| device")[1] == f"{gpu} (fig-3.1); {cpu} (fig-3.3)"
    row = ["`fig-3.1`", "2", "200", "1", "8.00 s", "1.50 s", "2026-01-02 10:01", "1"]
    assert cells(text, "| `fig-3.1` | 2 ") == row
    assert cells(text, "| `fig-3.3` | 2 ")[-2:] == ["2026-01-03 00:00", "2"]
    assert cells(text, "| all |")[3:] == ["2", "16.0 s", "3.00 s", "", ""]
    assert COMMAND in page.text and "25 min 33 s" in page.text


def test_one_command_has_no_number(tmp_path):
    folders = [
        write(tmp_path / name, [claim(name, "Fig. 3.1")], command=f"{COMMAND} --out /my/own --resume")
        for name in "ab"
    ]
    page, text = pages(tmp_path, folders)
    assert cells(text, "| command") == ["command", f"`{COMMAND}`"] and "/my/own" not in text + page.text
    assert cells(text, "| device")[1] == "platform gpu, kind NVIDIA H200, count 1"
    assert cells(text, "| `a` | 2 ")[-1] == "2026-01-02 10:01"


def test_sweeps_that_cannot_be_read_are_one_line_each(tmp_path):
    broken = {
        "no-claims": lambda folder: (folder / "claims.json").unlink(),
        "bad-claims": lambda folder: (folder / "claims.json").write_text('[{"id": 3}]'),
        "cut-claims": lambda folder: (folder / "claims.json").write_text("[{"),
        "bad-manifest": lambda folder: (folder / "manifest.json").write_text("[]"),
        "running": lambda folder: edit_manifest(folder, lambda manifest: manifest.update(status="running")),
        "bad-verdict": lambda folder: (folder / "claims.json").write_text(
            json.dumps([claim("x", None, verdict="proved")])
        ),
    }
    folders = [write(tmp_path / name, [claim(name, "Fig. 3.1")]) for name in ("good", *broken)]
    for folder, damage in zip(folders[1:], broken.values(), strict=True):
        damage(folder)
    errors = [{"error": None}, {"error": "out | of memory"}, {"error": "out | of memory"}]
    failed = write(tmp_path / "failed", [claim("f", "Fig. 3.3")], status="failed", chunks=errors)
    (failed / "runs.parquet").touch()  # some of its runs have ended
    page, text = pages(tmp_path, [*folders, failed, tmp_path / "nowhere"])
    rows = re.findall(r"^\| `(.*?)` \| (.*) \|$", text.split("## All claims")[0], re.MULTILINE)
    assert [name for name, _ in rows] == [*broken, "nowhere", "failed"]
    reasons = dict(rows)
    assert reasons["nowhere"] == "no such results folder"
    assert reasons["failed"] == "some runs are missing: out \\| of memory"
    assert "claims.json: no such file" in reasons["no-claims"] and "--resume" in reasons["running"]
    assert "[0].id" in reasons["bad-claims"] and "truncated" in reasons["cut-claims"]
    assert "2 claims, tested by 2 sweeps" in text and "Incomplete or left out: 8 sweeps." in text
    assert "statement good" in text and "statement f" in text
    assert all(name in page.text for name in reasons)
    page, text = pages(tmp_path / "new", [])
    assert "0 claims, tested by 0 sweeps" in page.text and "0 claims" in text


WHY = {"claims": ["c", "b"], "cause": "choice", "text": "Because of *it*, by -3.\n", "sweeps": ["study-ties"]}
OTHER = {"claims": ["a"], "cause": "slip", "text": "Not shown."}


def test_what_is_not_reproduced_is_explained_beside_the_numbers(tmp_path):
    claims = [
        claim("a", "Fig. 5.6b, p. 131"),
        claim("b", "Table 4.1, p. 98", "inconclusive"),
        claim("c", "Fig. 4.4, p. 97", "not reproduced"),
        claim("d", "Fig. 3.3, p. 74", "not reproduced", changed={"runs": [200, 20]}),
    ]
    folder = write(tmp_path / "mine", claims, report={"explanations": [OTHER, WHY]})
    page, text = pages(tmp_path, [folder])
    counts = (
        "Causes of the 2 not reproduced: 1 a choice that the thesis leaves open and 1 unexplained. "
        "Causes of the 1 inconclusive: 1 a choice that the thesis leaves open."
    )
    assert counts in page.text and counts in text
    assert "- why: unexplained.\n" in part(chapter(tmp_path, "chapter3")[1], "statement d")
    of_chapter, its_text = chapter(tmp_path, "chapter4")
    assert part(its_text, "statement c").splitlines()[4:] == [
        "- why: a choice that the thesis leaves open. Because of \\*it\\*, by \N{MINUS SIGN}3. "
        "Evidence: `study-ties`.",
        "- source: Fig. 4.4, p. 97; sweep: `mine`",
    ]
    again = "- why: a choice that the thesis leaves open, as said of [statement c](#mine-c)."
    assert again in part(its_text, "statement b")
    assert "why" not in chapter(tmp_path, "chapter5")[1]
    assert "Because of *it*, by \N{MINUS SIGN}3." in of_chapter.text


def test_what_a_few_runs_do_not_decide_is_not_called_unexplained(tmp_path):
    reason = {"test": {"kind": "share", "comparisons": [], "reason": "2 runs: at least 20 are needed"}}
    claims = [
        claim("a", "Fig. 3.1", "inconclusive"),
        claim("b", "Fig. 3.2", "inconclusive", ours=None, interval=None, runs=0, **reason),
    ]
    _, text = pages(tmp_path, [write(tmp_path / "mine", claims)])
    assert "Causes of the 2 inconclusive: 1 unexplained and 1 not tested." in text
    found = chapter(tmp_path, "chapter3")[1]
    assert [line for line in found.splitlines() if "why" in line] == [
        "- why: unexplained.",
        "- why: not tested.",
    ]


def test_an_alias_has_the_report_of_its_sweep():
    report = published_report("parking")
    assert report is not None and report.figures
    assert report == published_report("fig-4.6")


def test_earlier_results_of_a_published_sweep_have_its_explanations(tmp_path):
    report = published_report("fig-5.6b")
    assert report is not None and report.explanations, "choose a sweep that has an explanation"
    (each, *_) = report.explanations
    verdicts = [claim(name, "Fig. 5.6b", "not reproduced") for name in each.claims]
    outdated = {"explanations": [{**OTHER, "claims": list(each.claims), "text": "Outdated."}]}
    folders = [write(tmp_path / "earlier", verdicts, name="fig-5.6b", report=outdated)]
    pages(tmp_path, folders)
    page, text = chapter(tmp_path, "chapter5")
    assert " ".join(each.text.split()[:8]) in page.text and "Outdated." not in text
    edit_manifest(folders[0], lambda manifest: manifest.update(is_published=False))
    pages(tmp_path, folders)
    assert "Outdated." in chapter(tmp_path, "chapter5")[1], (
        "a user's sweep of the same name has explanations of its own"
    )


def test_no_section_if_all_is_reproduced_and_a_folder_in_the_way_is_one_line(tmp_path):
    page, text = pages(tmp_path, [write(tmp_path / "a", [claim("a", "Fig. 3.1")])])
    assert "Causes" not in text and "why" not in chapter(tmp_path, "chapter3")[1]
    (tmp_path / "file").write_text("in the way")
    with one_line(ResultsError):
        reproduction(tmp_path / "file", [], 1.0)


def test_the_page_shows_what_the_report_shows(tmp_path):
    why = {"claims": ["missing", "order-fails"], "cause": "slip", "text": "There are none."}
    report = {"figures": ["returns"], "explanations": [why]}
    folder = write_results(tmp_path / "parking", runs=40, recorded=0, report=report)
    edit_manifest(folder, lambda manifest: manifest.update(name="mine"))
    build_report(folder)
    page, _ = pages(tmp_path, [folder])
    report = Page((folder / "report.html").read_text())
    assert "Why: a slip of the thesis. There are none." in report.text
    assert "#why-order-fails" in report.loaded, "the second claim refers to the first"
    for entry in json.loads((folder / "claims.json").read_text()):
        assert entry["claim"] in page.text and entry["verdict"] in page.text
        if entry["test"]["kind"] == "share":
            low, high = entry["interval"]
            assert f"{entry['ours']:.1%} [{low:.1%}, {high:.1%}]" in page.text
    assert "no runs of cbts" in page.text  # why a claim has no verdict


def test_the_page_is_made_without_jax_and_without_matplotlib(tmp_path):
    folder = write(tmp_path / "fig-3.1", [claim("a", "Fig. 3.1")])
    code = (
        "import sys, pathlib; from bojax.claims.reproduction import reproduction; "
        f"reproduction(pathlib.Path({str(tmp_path)!r}), [pathlib.Path({str(folder)!r})], 1.0); "
        "print([name for name in ('jax', 'equinox', 'matplotlib') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
