"""Results folders: nothing is overwritten, and what is unfinished is found again."""

import pytest

from bojax.results.folder import RunFolder, check_finished, check_plan, choose_folder, is_unfinished
from bojax.results.store import ResultsError, write_json

PLAN = {"runs": 3, "config": {"planner": {"kind": "kcbts", "iterations": 300}}, "code": {"bojax": "a"}}


def test_a_new_folder_has_a_timestamp_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda _: "20260101-000000")
    first, is_resumed = choose_folder("parking", None, resume=False)
    assert str(first) == "results/parking/20260101-000000" and not is_resumed
    first.mkdir(parents=True)
    second, _ = choose_folder("parking", None, resume=False)
    assert second.name == "20260101-000000-2"


def test_an_empty_folder_is_taken(tmp_path):
    assert choose_folder("parking", tmp_path, resume=False) == (tmp_path, False)
    assert choose_folder("parking", tmp_path / "new", resume=True) == (tmp_path / "new", False)


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_of_something_else_is_refused(tmp_path, resume):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ResultsError, match="not empty") as error:
        choose_folder("parking", tmp_path, resume=resume)
    assert error.value.exit_code == 2


def test_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="not a folder"):
        choose_folder("parking", tmp_path / "file", resume=False)


def test_life_of_a_folder(tmp_path):
    path = tmp_path / "a" / "b"
    folder = RunFolder(path)
    folder.create(PLAN)
    folder.note("groups", {"0": 1})
    assert is_unfinished(path)
    with pytest.raises(ResultsError, match="not empty"):
        choose_folder("parking", path, resume=False)
    with pytest.raises(ResultsError, match="another process"):
        RunFolder(path).resume(PLAN)
    folder.close(finished=False)
    again = RunFolder(path)
    again.resume(PLAN)
    assert again.noted("groups", None) == {"0": 1} and again.noted("other", "nothing") == "nothing"
    again.close(finished=True)
    assert not is_unfinished(path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"runs": 4}, "runs: 3 -> 4"),
        ({"config": {"planner": {"kind": "sbo", "iterations": 300}}}, "config.planner.kind: kcbts -> sbo"),
        ({"config": {"planner": {"kind": "kcbts"}}}, "config.planner.iterations: 300 -> None"),
        ({"extra": [1, 2]}, r"extra: None -> \[1, 2\]"),
    ],
)
def test_changes_are_named(tmp_path, change, named):
    check_plan(tmp_path, PLAN, PLAN)
    with pytest.raises(ResultsError, match=named) as error:
        check_plan(tmp_path, PLAN, {**PLAN, **change})
    assert "\n" not in str(error.value)


def test_a_change_of_base_and_points_is_told_once(tmp_path):
    def plan(iterations):
        config = {"planner": {"iterations": iterations}}
        return {"config": config, "points": [{"config": config}] * 9}

    with pytest.raises(ResultsError) as error:
        check_plan(tmp_path, plan(1), plan(2))
    assert str(error.value).count("1 -> 2") == 1


def test_a_finished_folder_may_come_from_other_code(tmp_path):
    write_json(tmp_path / "manifest.json", {"plan": PLAN})
    check_finished(tmp_path, {**PLAN, "code": {"bojax": "b"}})
    with pytest.raises(ResultsError, match="runs: 3 -> 4"):
        check_finished(tmp_path, {**PLAN, "runs": 4})
