"""Attempts at chunks: who may write where, what is taken over, and when a chunk has failed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pytest

from bojax.results.attempts import AttemptRegistry, is_gone, process_identity
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import ResultsError, read_table, write_json

CHUNK, OTHER = "chunk-00000-0123456789ab", "chunk-00001-ba9876543210"


@pytest.fixture
def work(tmp_path) -> Path:
    (tmp_path / ".work").mkdir()
    return tmp_path / ".work"


def registry(work: Path) -> AttemptRegistry:
    return AttemptRegistry(work, work.parent)


def begin(work: Path, launch: str = "first") -> ChunkFolder:
    files = registry(work).begin(CHUNK, launch)
    assert files is not None
    return files


def commit(files: ChunkFolder, text: str, *, is_done: bool = False) -> None:
    files.write_piece({"steps": pa.table({"text": [text]})})
    files.state.is_done = is_done
    files.commit()


def rows(work: Path) -> list[str]:
    files = registry(work).committed(CHUNK)
    paths = [] if files is None else files.pieces("steps")
    return [row for path in paths for row in read_table(path)["text"].to_pylist()]


def test_an_attempt_is_done_once_and_stays_done(work):
    attempts = registry(work)
    files = attempts.begin(CHUNK, "first")
    assert files is not None and files.path == work / f"{CHUNK}-1"
    assert attempts.begin(OTHER, "first") is not None
    commit(files, "all", is_done=True)
    attempts.end(files, "done", {"seconds": 1.0})
    for each in (attempts, registry(work)):
        assert each.has_ended(CHUNK) and not each.has_ended(OTHER)
        assert each.begin(CHUNK, "first") is None and each.note(CHUNK, "done") == {"seconds": 1.0}
    assert rows(work) == ["all"]


def test_the_next_attempt_goes_on_from_the_last_commit_and_a_zombie_writes_in_its_own_folder(work):
    before = registry(work)
    first = begin(work)
    commit(first, "committed")
    first.write_piece({"steps": pa.table({"text": ["not committed"]})})
    second = before.begin(CHUNK, "second")  # it has not seen the first
    assert second is not None and second.path == work / f"{CHUNK}-2"
    assert second.state.pieces == 1 and rows(work) == ["committed"]
    commit(second, "by the second")
    first.commit()  # the zombie wakes up, in the middle and at the end
    assert rows(work) == ["committed", "by the second"]
    commit(second, "end", is_done=True)
    registry(work).end(second, "done", {})
    commit(first, "too late", is_done=True)
    registry(work).end(first, "done", {})
    assert registry(work).done == {CHUNK: 2} and rows(work) == ["committed", "by the second", "end"]


def test_a_paused_attempt_is_taken_over_and_deleted(work):
    first = begin(work)
    commit(first, "half")
    registry(work).end(first, "paused", {})
    assert registry(work).paused == {CHUNK: 1}
    second = begin(work)
    assert second.state.pieces == 1 and not first.path.exists() and rows(work) == ["half"]


def test_a_chunk_whose_owner_is_lost_twice_in_a_launch_without_a_commit_has_failed(work):
    for text in ("a", "b"):
        commit(begin(work), text)
    begin(work)  # the owner of the second attempt is lost after its commit, this one before any
    attempts = registry(work)
    assert attempts.begin(CHUNK, "first") is None and attempts.has_ended(CHUNK)
    assert attempts.reason(CHUNK) == "2 workers were lost in succession while they ran it"
    assert rows(work) == ["a", "b"]
    attempts.forget(CHUNK, "failed")  # the next launch tries it again
    assert attempts.begin(CHUNK, "second") is not None


def test_who_is_paused_is_not_lost(work):
    for _ in range(4):
        registry(work).end(begin(work), "paused", {})
    assert not registry(work).failed


def test_an_owner_that_runs_beside_another_one_is_not_lost(work):
    """As a worker that somebody starts beside a command which runs the sweep itself."""
    for _ in range(4):
        path = begin(work).path / "attempt.json"
        path.write_text(
            json.dumps({**json.loads(path.read_text()), "process": process_identity(os.getppid())})
        )
    assert not registry(work).failed


def test_a_failure_is_final(work):
    attempts = registry(work)
    attempts.end(begin(work), "failed", {"error": "boom"})
    assert attempts.failed == {CHUNK: 1} and attempts.begin(CHUNK, "first") is None
    assert registry(work).reason(CHUNK) == "boom"
    (work / f"{CHUNK}-1.failed").write_text("[1]")
    assert registry(work).reason(CHUNK) == "for a reason that is damaged"


def test_an_owner_lost_before_it_could_say_that_a_chunk_is_done(work):
    commit(begin(work), "all", is_done=True)
    attempts = registry(work)
    assert attempts.begin(CHUNK, "first") is None and attempts.has_ended(CHUNK) and rows(work) == ["all"]


def test_deleting_the_folder_of_an_attempt_forgets_how_it_ended(work):
    files = begin(work)
    commit(files, "bad", is_done=True)
    registry(work).end(files, "done", {})
    for path in files.path.iterdir():
        path.unlink()
    files.path.rmdir()
    assert begin(work).path == work / f"{CHUNK}-2"  # a number is never used twice


def test_what_is_missing_or_damaged_holds_up_nobody(work):
    """An owner that was lost between two operations, or a file that was edited."""
    for number, content in enumerate((None, "", "[1]", '{"launch": 1}'), 1):
        (work / f"{CHUNK}-{2 * number - 1}").mkdir()
        if content is not None:
            (work / f"{CHUNK}-{2 * number - 1}" / "attempt.json").write_text(content)
        assert begin(work).path == work / f"{CHUNK}-{2 * number}"
    (work / f"{CHUNK}-{10**40}").mkdir()
    assert begin(work).path == work / f"{CHUNK}-{10**40 + 1}"
    (work / f"{CHUNK}-{'9' * 230}").mkdir()
    with pytest.raises(ResultsError, match="cannot be written: File name too long"):
        begin(work)


def test_damaged_files_of_a_predecessor_are_named(work):
    files = begin(work)
    commit(files, "half")
    (files.path / "piece-000000-steps.parquet").write_text("")
    attempts = registry(work)
    with pytest.raises(
        ResultsError, match=f"changed since it was written; delete the folder {files.path} and"
    ):
        attempts.begin(CHUNK, "first")
    assert registry(work).paused == {CHUNK: 2}  # this was no loss


def test_where_there_are_no_links_files_are_copied(work, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    commit(begin(work), "half")
    assert begin(work).state.pieces == 1 and rows(work) == ["half"]


def test_stray_files_are_no_attempts(work):
    for name in (f"{CHUNK}-1.tmp", f".{CHUNK}-1.done.tmp", "chunk-1-2", f"{CHUNK}", f"{CHUNK}-2.done"):
        (work / name).write_text("")
    write_json(work / "worker-x.json", {"beats": 1})
    attempts = registry(work)
    assert attempts.begun() == [CHUNK] and attempts.newest(CHUNK) == 2 and not attempts.done


def test_processes_are_told_apart(work):
    own = process_identity(os.getpid())
    if own is None:
        pytest.skip("needs /proc")
    assert is_gone(own) is False and is_gone(None) is None
    assert is_gone([*own[:3], "0"])  # the number was used again
    assert is_gone(["another boot", *own[1:]]) is None  # of another machine
    begin(work)
    mine = registry(work).attempt(CHUNK, 1)
    assert mine is not None and mine.process == own and mine.owner.endswith(f"-{os.getpid()}")
    code = "import os; from bojax.results.attempts import process_identity as p; print(*p(os.getpid()))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert is_gone(shown.stdout.split())
