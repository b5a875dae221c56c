"""Results of several commands on one page: the newest of each sweep, judged by today's claims."""

import json
import re

import pytest

from bojax.claims.collected import collected
from bojax.claims.reproduction import joined_reproduction
from bojax.cli.main import main
from bojax.config.sweep import load_published
from bojax.config.sweep_file import published_name
from bojax.report.build import build_report
from bojax.results.store import ResultsError
from tests.refusals import one_line
from tests.report.synthetic import edit_manifest, write_results


def results(folder, name="fig-4.6", **changes):
    """Made-up results under the name of a sweep of bojax, with a report."""
    write_results(folder, recorded=0)
    known = {"name": name, "written": "2026-01-02T10:00:00+0000", "command": f"bojax reproduce {name}"}
    claims = [claim.model_dump(mode="json") for claim in load_published("fig-4.6").claims]

    def edit(manifest):
        manifest.update(known | {"claims": claims} | changes)
        (nine,) = (point for point in manifest["points"] if point["variant"] == "sbo-9")
        nine["variant"] = "sbo"  # which the claims name

    edit_manifest(folder, edit)
    return folder


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A results folder with its report."""
    folder = results(tmp_path_factory.mktemp("reported") / "old")
    build_report(folder)
    return folder


def verdicts(folder):
    """The verdict of each claim of the only sweep in a folder."""
    ((found, _),) = collected([folder])
    return {claim.id: claim.verdict for claim in found.claims}


def test_the_newest_results_of_a_sweep_count(tmp_path, capsys):
    newest = {"written": "2026-01-03T10:00:00+0000", "command": "bojax reproduce fig-4.6 --out b"}
    results(tmp_path / "a" / "x", **newest)
    results(tmp_path / "a" / "y", name="parking")  # another name of fig-4.6
    results(tmp_path / "b" / "fig-4.8", name="fig-4.8")
    results(tmp_path / "a" / "unfinished", status="running")
    results(tmp_path / "a" / "mine", name="mine")
    results(tmp_path / "b" / "study-ties", name="study-ties")
    readme = tmp_path / "readme.md"
    sentence = "Of 0 claims of it, with 200 runs,\n0 are reproduced, 0 are not, and 0\nare inconclusive"
    readme.write_text(f"{sentence}; 7 of\nthem rest on.")
    page = tmp_path / "page.md"
    sources = [str(tmp_path / name) for name in "ab"]
    words = ["--page", *sources, "--out", str(page), "--count-in", str(readme)]
    assert main(["reproduce", *words]) == 0
    told, text = capsys.readouterr(), page.read_text()
    assert told.out == f"{page}\n"
    numbers = re.search(
        r"^(\d+) claims, tested by 2 sweeps: (\d+) rep.*?, (\d+) not .*? and (\d+) inc.*?; (\d+) of",
        text,
        re.M,
    )
    assert numbers and told.err.startswith(f"{numbers[1]} claims: {numbers[2]} reproduced")
    total, *counts = numbers.groups()
    assert re.findall(r"\d+", readme.read_text()) == [total, "200", *counts]
    assert (
        "| command 1 | `bojax reproduce fig-4.8` |" in text
        and "| command 2 | `bojax reproduce fig-4.6` |" in text
    )
    assert re.search(r"\| `fig-4.6` \| .* \| 2026-01-03 10:00 \| 2 \|", text)
    assert "no finished results" not in text, "most have none: the page is meant for these"


def test_sweeps_without_results_are_named(reported, tmp_path):
    joined_reproduction([tmp_path / "p.md"], [reported], ["fig-4.6", "table-5.1"])
    text = (tmp_path / "p.md").read_text()
    assert re.findall(r"\| `(.*)` \| no finished results in these folders \|", text) == ["table-5.1"]


def test_verdicts_are_those_of_todays_tests(reported, tmp_path):
    decided = verdicts(reported)
    assert set(decided.values()) == {"reproduced", "not reproduced", "inconclusive"}
    old = results(tmp_path / "old", claims=[])
    (old / "claims.json").write_text("[]")
    assert verdicts(old) == decided, "claims are those of the sweep, not of the results"


def test_a_verdict_is_kept_where_its_table_is_missing(reported):
    before = verdicts(reported)
    (reported / "steps.parquet").rename(reported / "elsewhere")
    entries = json.loads((reported / "claims.json").read_text())
    falls = next(entry for entry in entries if entry["id"] == "fig-4.6/sbo-falls")
    try:
        assert verdicts(reported) == before
        falls["test"]["to"] = 7
        (reported / "claims.json").write_text(json.dumps(entries))
        assert verdicts(reported) == {**before, falls["id"]: "inconclusive"}, "of another test"
    finally:
        (reported / "elsewhere").rename(reported / "steps.parquet")


def test_settings_that_the_sweep_has_no_longer_are_changed(reported):
    ((found, _),) = collected([reported])
    assert found.results.manifest.changed["runs"] == [200, 40]
    assert all(claim.changed["runs"] == [200, 40] for claim in found.claims)


def test_a_setting_of_one_variant_changes_the_claims_of_that_variant_alone(tmp_path):
    def deepen(manifest):
        (kcbts,) = (point for point in manifest["points"] if point["variant"] == "kcbts")
        kcbts["config"]["planner"]["depth"] = 17

    before, after = results(tmp_path / "before"), results(tmp_path / "after")
    edit_manifest(after, deepen)
    ((old, _),), ((new, _),) = (collected([folder]) for folder in (before, after))
    touched = {
        now.id for then, now in zip(old.claims, new.claims, strict=True) if now.changed != then.changed
    }
    of_kcbts = {claim.id for claim in load_published("fig-4.6").claims if "kcbts" in claim.test.names}
    assert touched == of_kcbts and 0 < len(touched) < len(new.claims)


def test_other_results_are_refused(tmp_path):
    folder = results(tmp_path / "x")
    for changes, error in (
        ({"status": "running"}, "has not finished"),
        (
            {"status": "finished", "name": "mine"},
            "got results of mine; allowed: those of sweeps of bojax",
        ),
        ({"name": "fig-4.6", "is_published": False}, "got results of fig-4.6; allowed"),
    ):
        edit_manifest(folder, lambda manifest, changes=changes: manifest.update(changes))
        with one_line(ResultsError, error):
            collected([folder])
    edit_manifest(folder, lambda manifest: manifest.update(name="study-ties", is_published=True))
    with pytest.raises(
        ResultsError, match="got results of study-ties; allowed: also those of a sweep of the"
    ):
        joined_reproduction([tmp_path / "p.md"], [folder], ["fig-4.6"])


def test_misuse_is_one_line(here, refusal):
    for words, error in (
        ("--page nowhere", "no such results folder"),
        ("--page . --out p.md", "manifest.json"),
        ("fig-4.6 --page .", "ID: not allowed with --page"),
        ("--page . --runs 3", "--runs: not allowed with --page"),
        ("--count-in README.md -- fig-4.6", "--count-in: needs --page"),
        ("", "the following arguments are required: ID"),
    ):
        assert error in refusal(f"reproduce {words}")


def test_a_page_to_count_in_needs_the_sentence(tmp_path, reported, refusal):
    (tmp_path / "other.md").write_text("Of claims.")
    out = f"--out {tmp_path}/p.md --count-in {tmp_path}/other.md"
    assert "got 0 sentences on claims" in refusal(f"reproduce --page {reported} {out}")
    assert not (tmp_path / "p.md").exists()


def test_names_of_published_sweeps():
    assert published_name("parking") == published_name("fig-4.6") == "fig-4.6"
    assert published_name("mine") is published_name("../sweeps/fig-4.6") is None
