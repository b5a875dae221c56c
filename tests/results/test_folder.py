"""Results folders: nothing is overwritten, and unfinished sweeps are resumed."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bojax.results.folder import (
    NothingToResume,
    RunFolder,
    check_finished,
    check_plan,
    choose_folder,
    is_unfinished,
)
from bojax.results.store import MANIFEST, ResultsError, read_manifest, write_json
from tests.refusals import one_line

PLAN = {"runs": 3, "config": {"planner": {"kind": "kcbts", "iterations": 300}}, "code": {"bojax": "a"}}


def test_folders_of_the_same_second_are_numbered(here, monkeypatch):
    monkeypatch.setattr("time.strftime", lambda _: "20260101-000000")
    # All are chosen before the first is created, as by processes that start together.
    chosen = [choose_folder("parking", None, resume=False) for _ in range(3)]
    assert {(str(path), is_resumed) for path, is_resumed in chosen} == {
        ("results/parking/20260101-000000", False)
    }
    assert not Path("results").exists()
    folders = [RunFolder(path) for path, _ in chosen]
    for folder in folders:
        folder.create(PLAN, may_rename=True)
    assert [folder.path.name for folder in folders] == [f"20260101-000000{end}" for end in ("", "-2", "-3")]


def test_a_folder_given_by_the_user_is_used_once(tmp_path):
    RunFolder(tmp_path / "out").create(PLAN)
    with pytest.raises(ResultsError, match="another process"):
        RunFolder(tmp_path / "out").create(PLAN)


@pytest.mark.parametrize("parts", [("x" * 300,), ("folder", "y" * 5000)])
@pytest.mark.parametrize("resume", [False, True])
def test_names_longer_than_the_file_system_allows(tmp_path, parts, resume):
    path, is_resumed = choose_folder("parking", tmp_path.joinpath(*parts), resume=resume)
    assert not is_resumed and not is_unfinished(path)
    with pytest.raises(ResultsError, match="File name too long"):
        RunFolder(path).create(PLAN)
    with pytest.raises(ResultsError, match="not a results folder"):
        read_manifest(path)


def test_an_empty_folder_is_used_and_one_with_other_content_is_refused(tmp_path):
    assert choose_folder("parking", tmp_path, resume=False) == (tmp_path, False)
    assert choose_folder("parking", tmp_path / "new", resume=True) == (tmp_path / "new", False)
    (tmp_path / "thesis.tex").write_text("")
    for resume in (False, True):
        with pytest.raises(ResultsError, match="not empty") as error:
            choose_folder("parking", tmp_path, resume=resume)
        assert error.value.exit_code == 2
    with pytest.raises(ResultsError, match="not a folder"):
        choose_folder("parking", tmp_path / "thesis.tex", resume=False)


def test_the_newest_unfinished_folder_is_resumed(here):
    with pytest.raises(NothingToResume, match="no unfinished sweep to resume"):
        choose_folder("parking", None, resume=True)
    for number in (1, 2, 3):
        folder = RunFolder(Path(f"results/parking/2026010{number}-000000"))
        folder.create(PLAN)
        folder.close(finished=number == 3)
    assert choose_folder("parking", None, resume=True) == (Path("results/parking/20260102-000000"), True)


def test_a_folder_in_the_results_of_another_sweep_is_refused(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / MANIFEST).write_text("{}")
    for below in ("more", "arrays/more"):
        with pytest.raises(ResultsError, match="in the results of another sweep, .*; give another --out"):
            choose_folder("parking", tmp_path / "results" / below, resume=False)
    assert choose_folder("parking", tmp_path / "more", resume=False) == (tmp_path / "more", False)


def test_life_of_a_folder(tmp_path):
    path = tmp_path / "a" / "b"
    folder = RunFolder(path)
    folder.create(PLAN)
    launch = folder.launch({"name": "parking"})
    assert folder.launched() == launch and launch.sweep == {"name": "parking"} and launch.left is None
    assert is_unfinished(path)
    with pytest.raises(ResultsError, match="not empty"):
        choose_folder("parking", path, resume=False)
    with pytest.raises(ResultsError, match="another process"):
        RunFolder(path).resume(PLAN)
    folder.close(finished=False)
    again = RunFolder(path)
    again.resume(PLAN)
    assert again.plan() == PLAN
    again.close(finished=True)
    assert not is_unfinished(path)
    with pytest.raises(ResultsError, match="no unfinished sweep in this folder on .*; allowed: "):
        again.launched()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"runs": 4}, "runs: 3 -> 4"),
        ({"config": {"planner": {"kind": "sbo", "iterations": 300}}}, "config.planner.kind: kcbts -> sbo"),
        ({"config": {"planner": {"kind": "kcbts"}}}, "config.planner.iterations: 300 -> None"),
        ({"extra": [1, 2]}, r"extra: None -> \[1, 2\]"),
        ({"extra": [1] * 100}, "extra: None -> a list of 100;"),
        ({"code": {"bojax": "b"}}, "changed: code.bojax: the source differs; undo"),
    ],
)
def test_changes_are_named(tmp_path, change, named):
    check_plan(tmp_path, PLAN, PLAN)
    with one_line(ResultsError, named):
        check_plan(tmp_path, PLAN, {**PLAN, **change})


def test_a_change_of_base_and_points_is_reported_once(tmp_path):
    def plan(iterations):
        config = {"planner": {"iterations": iterations}}
        return {"config": config, "points": [{"config": config}] * 9}

    with pytest.raises(ResultsError) as error:
        check_plan(tmp_path, plan(1), plan(2))
    assert str(error.value).count("1 -> 2") == 1


def test_a_finished_folder_may_come_from_other_code(tmp_path):
    write_json(tmp_path / "manifest.json", {"status": "finished", "plan": PLAN})
    check_finished(tmp_path, {**PLAN, "code": {"bojax": "b"}})
    with pytest.raises(ResultsError, match="runs: 3 -> 4"):
        check_finished(tmp_path, {**PLAN, "runs": 4})


@pytest.mark.parametrize(
    ("manifest", "named"),
    [
        (
            {"status": "interrupted", "plan": PLAN},
            r"status is interrupted.*\.work is missing; give another --out",
        ),
        ({"status": "finished"}, "plan: got a NoneType; allowed: a mapping"),
        ({"status": "finished", "plan": [1]}, "plan: got a list; allowed: a mapping"),
        ([1], "got a list; allowed: a mapping"),
        (None, "got a NoneType; allowed: a mapping"),
    ],
)
def test_a_manifest_that_does_not_say_finished(tmp_path, manifest, named):
    write_json(tmp_path / "manifest.json", manifest)
    with one_line(ResultsError, named):
        check_finished(tmp_path, PLAN)


@pytest.mark.parametrize("damage", ['{"runs": 4}', '{"runs": 3, "sha256": "00"}', "[1]", '"x', "[" * 10**5])
def test_a_damaged_plan_is_refused(tmp_path, damage):
    folder = RunFolder(tmp_path / "out")
    folder.create(PLAN)
    folder.launch({})
    folder.close(finished=False)
    (folder.work / "launch.json").write_text(damage)
    with pytest.raises(
        ResultsError, match="launch.json: missing or damaged; start the sweep again with --res"
    ):
        folder.launched()
    (folder.work / "plan.json").write_text(damage)
    with pytest.raises(ResultsError, match="plan.json: damaged: delete this file and resume"):
        folder.resume(PLAN)
    folder.close(finished=False)
    (folder.work / "plan.json").unlink()
    folder.resume(PLAN)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_lock_that_is_not_a_file_is_refused(tmp_path, make):
    folder = RunFolder(tmp_path / "out")
    folder.create(PLAN)
    folder.close(finished=False)
    (folder.work / "lock").unlink()
    make(folder.work / "lock")
    with pytest.raises(ResultsError, match="cannot be written: "):
        folder.resume(PLAN)


def test_the_first_worker_commits_the_plan(tmp_path):
    folder = RunFolder(tmp_path / "out")
    folder.create(None)
    assert folder.plan() is None
    folder.join(PLAN, {"platform": "gpu", "count": 2})
    folder.join(PLAN, {"platform": "gpu", "count": 1})
    assert folder.plan() == PLAN and folder.device() == {"platform": "gpu", "count": 2}
    with pytest.raises(ResultsError, match="does not fit the plan: code.bojax: the source differs"):
        folder.join({**PLAN, "code": {"bojax": "b"}}, {})
    assert sorted(path.name for path in folder.work.iterdir()) == ["device.json", "lock", "plan.json"]


def test_workers_that_start_at_once_all_join(tmp_path):
    folder = RunFolder(tmp_path / "out")
    folder.create(None)
    device = {"platform": "gpu", "count": 2}
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: (folder.describe(device), folder.join(PLAN, device)), range(100)))
    assert folder.plan() == PLAN and folder.device() == device
    assert sorted(path.name for path in folder.work.iterdir()) == ["device.json", "lock", "plan.json"]
