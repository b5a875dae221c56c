"""`bojax reproduce surveys`: pieces are kept, resumed, and never mixed with those of other settings."""

import json

import pytest

from bojax.cli.main import main
from bojax.surveys.league import cells, fields


@pytest.fixture(scope="module")
def all_fields():
    return fields.league()


@pytest.fixture(autouse=True)
def quick(monkeypatch, all_fields):
    """Pieces with made-up errors, and a list of those that were computed."""
    computed = []

    def result(cell):
        computed.append(cell.name)
        methods = ("bojax", "lawnmower") if cell.goal == "map" else (f"bojax, {cell.goal}",)
        errors = dict.fromkeys(("rmse", "deviation", "regret", "missed", "f1"), 1.0)
        return {
            "length": cell.length,
            "start": cell.start,
            "seconds": 1.0,
            "routes": {method: [[0.0, 0.0], [1.0, 1.0]] for method in methods},
            "scores": {field.name: dict.fromkeys(methods, errors) for field in cell.fields},
        }

    monkeypatch.setattr(cells.Cell, "result", result)
    monkeypatch.setattr(fields, "league", lambda: all_fields)
    return computed


def test_only_missing_pieces_are_computed(quick, tmp_path, capsys):
    out = tmp_path / "league"
    assert main(["reproduce", "surveys", "--runs", "1", "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(out / "league.html"), str(out / "league.md")]
    first = list(quick)
    (out / "cells" / first[3]).unlink()
    quick.clear()
    assert main(["reproduce", "surveys", "--runs", "2", "--out", str(out), "--resume"]) == 0
    assert quick[0] == first[3] and len(quick) == 1 + len(first)
    assert {name[-7:] for name in quick[1:]} == {"01.json"}


def test_a_piece_that_fails_is_one_line_and_does_not_stop_the_others(quick, tmp_path, capsys, monkeypatch):
    working = cells.Cell.result

    def result(cell):
        if cell.name == "hotspots-elevation-20-00.json":
            raise ValueError("no route")
        return working(cell)

    monkeypatch.setattr(cells.Cell, "result", result)
    out = tmp_path / "league"
    assert main(["reproduce", "surveys", "--runs", "1", "--out", str(out)]) == 1
    assert "hotspots-elevation-20-00.json, failed: no route\n" in capsys.readouterr().err
    assert (out / "league.html").exists()
    monkeypatch.setattr(cells.Cell, "result", working)
    quick.clear()
    assert main(["reproduce", "surveys", "--runs", "1", "--out", str(out), "--resume"]) == 0
    assert quick == ["hotspots-elevation-20-00.json"]


def test_pieces_of_other_choices_are_not_mixed(quick, tmp_path, capsys):
    out = tmp_path / "league"
    assert main(["reproduce", "surveys", "--runs", "1", "--out", str(out)]) == 0
    about = json.loads((out / "league.json").read_text())
    (out / "league.json").write_text(json.dumps({**about, "leg": 2.5}))
    assert main(["reproduce", "surveys", "--runs", "1", "--out", str(out), "--resume"]) == 2
    # Without iris-sample-data, a note on the fields that are left out precedes the error.
    assert "leg: 2.5 -> 5.0" in capsys.readouterr().err.splitlines()[-1]


def test_mistakes_are_one_line(here, refusal):
    for words, message in (
        ("surveys fig-4.6", "surveys: not allowed with other IDs"),
        ("surveys --seed 3", "--seed: not allowed with surveys"),
        ("surveys --launcher ray", "--launcher: not allowed with surveys"),
        ("surveys --runs 21", "--runs: got 21; allowed: 1 to 20"),
        ("surveys --resume", "--resume: needs --out"),
    ):
        assert message in refusal(f"reproduce {words}")
