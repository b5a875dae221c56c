"""Leases, with a clock that stands still until a test moves it."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow as pa
import pytest

from bojax.results.leases import Attempts, Leases, Standing, is_gone, process_identity
from bojax.results.store import ResultsError, write_json

CHUNK, OTHER = "chunk-00000-0123456789ab", "chunk-00001-ba9876543210"
SECONDS = 60.0


class Clock:
    """A clock of one process, with an origin of its own."""

    def __init__(self, now: float):
        self.now = now

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def work(tmp_path) -> Path:
    (tmp_path / ".work").mkdir()
    return tmp_path / ".work"


def worker(work: Path, owner: str, *, now: float = 0.0, launch: int = 1, **given) -> tuple[Leases, Clock]:
    clock = Clock(now)
    leases = Leases(work, work.parent, launch=launch, seconds=SECONDS, clock=clock, owner=owner, **given)
    leases.beat()
    return leases, clock


def commit(files, text: str) -> None:
    files.write_part({"steps": pa.table({"text": [text]})})
    files.commit()


def parts(leases: Leases, chunk: str = CHUNK) -> list[str]:
    files = leases.attempts.committed(chunk, leases.attempts.work.parent)
    return (
        [] if files is None else [row for table in files.tables("steps") for row in table["text"].to_pylist()]
    )


def test_heartbeats_of_two_threads_are_whole(work, monkeypatch):
    # The thread of heartbeats and the manifest's writer both send them.
    a, _ = worker(work, "a")
    writing = [0]
    together = []

    def write_slowly(*args, **kwargs):
        writing[0] += 1
        time.sleep(0.02)
        together.append(writing[0])
        write_json(*args, **kwargs)
        writing[0] -= 1

    monkeypatch.setattr("bojax.results.leases.write_json", write_slowly)
    threads = [threading.Thread(target=a.beat) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == [1, 1, 1]
    heartbeat = a.attempts.heartbeat("a")
    assert heartbeat is not None and heartbeat.beats == 4


def test_a_chunk_belongs_to_one(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    files = a.take(CHUNK)
    assert files is not None and files.path == work / f"{CHUNK}-1"
    assert b.take(CHUNK) is None and b.take(OTHER) is not None
    for each in (a, b):
        each.look()
        assert each.standing(CHUNK) is each.standing(OTHER) is Standing.HELD
    commit(files, "a")
    a.finish(CHUNK, {"seconds": 1.0})
    b.look()
    assert b.standing(CHUNK) is Standing.DONE and b.take(CHUNK) is None
    assert parts(b) == ["a"]


def test_one_of_two_that_take_at_the_same_time_wins(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    b.look()  # before the other takes it
    assert a.take(CHUNK) is not None
    assert b.standing(CHUNK) is Standing.FREE and b.take(CHUNK) is None
    assert sorted(path.name for path in work.glob("chunk-*")) == [f"{CHUNK}-1"]


def test_a_lease_ends_when_its_counter_stands_still_by_the_clock_of_who_looks(work):
    # The clocks of the two differ by a day.
    (a, a_clock), (b, b_clock) = worker(work, "a"), worker(work, "b", now=86_400.0)
    assert a.take(CHUNK) is not None
    for _ in range(5):  # as long as there are heartbeats
        b_clock.now += SECONDS - 1
        b.look()
        assert b.standing(CHUNK) is Standing.HELD
        a_clock.now += 10.0
        a.beat()
    assert b.is_alive(CHUNK)
    b.look()
    assert b.standing(CHUNK) is Standing.HELD
    a_clock.now += 10 * SECONDS  # the owner's clock does not matter
    assert b.standing(CHUNK) is Standing.HELD
    b_clock.now += SECONDS - 1
    assert b.take(CHUNK) is None
    b_clock.now += 1
    taken = b.take(CHUNK)
    assert taken is not None and taken.path == work / f"{CHUNK}-2"
    a.beat()
    assert a.is_stolen(CHUNK) and not b.is_stolen(CHUNK)


def test_nobody_is_seen_alive_at_the_first_look(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    a.take(CHUNK)
    b.look()
    assert b.standing(CHUNK) is Standing.HELD and not b.is_alive(CHUNK)
    a.beat()
    assert b.standing(CHUNK) is Standing.HELD and b.is_alive(CHUNK)


def test_a_thief_goes_on_from_the_last_commit_and_a_zombie_writes_in_its_own_folder(work):
    (a, _), (b, clock) = worker(work, "a"), worker(work, "b")
    first = a.take(CHUNK)
    commit(first, "committed by a")
    first.write_part({"steps": pa.table({"text": ["not committed"]})})
    b.look()
    assert b.standing(CHUNK) is Standing.HELD
    clock.now += SECONDS
    second = b.take(CHUNK)
    assert second.state.parts == 1 and parts(b) == ["committed by a"]
    commit(second, "by b")
    first.commit()  # the zombie wakes up, in the middle and at the end
    assert parts(b) == ["committed by a", "by b"]
    second.state.is_done = True
    second.commit()
    b.finish(CHUNK, {})
    commit(first, "too late")
    a.finish(CHUNK, {})
    b.look()
    assert b.attempts.complete[CHUNK] == 2 and parts(b) == ["committed by a", "by b"]


def test_a_zombie_that_ends_first_is_as_good(work):
    (a, _), (b, clock) = worker(work, "a"), worker(work, "b")
    first = a.take(CHUNK)
    b.look()
    b.standing(CHUNK)
    clock.now += SECONDS
    assert b.take(CHUNK) is not None
    commit(first, "all of it")
    a.finish(CHUNK, {})
    b.look()
    assert b.standing(CHUNK) is Standing.DONE and parts(b) == ["all of it"]


def test_a_lease_given_back_is_free_at_once(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    first = a.take(CHUNK)
    commit(first, "half")
    a.give_back(CHUNK)
    second = b.take(CHUNK)
    assert second.state.parts == 1 and not first.path.exists()  # nobody writes there any more
    assert parts(b) == ["half"]


def test_the_owner_of_a_lease_on_this_machine_that_is_gone_need_not_be_waited_for(work):
    code = (
        "import sys; from pathlib import Path; from bojax.results.leases import Leases; "
        "work = Path(sys.argv[1]); leases = Leases(work, work.parent, launch=1, seconds=60.0, owner='a'); "
        f"leases.beat(); leases.take('{CHUNK}')"
    )
    subprocess.run([sys.executable, "-c", code, work], check=True, cwd=Path(__file__).parents[2])
    b, _ = worker(work, "b")
    b.look()
    assert b.standing(CHUNK) is Standing.FREE


def test_processes_are_told_apart():
    own = process_identity(os.getpid())
    if own is None:
        pytest.skip("needs /proc")
    assert not is_gone(own) and not is_gone(None)
    assert is_gone([*own[:3], "0"])  # the number was used again
    assert not is_gone(["another boot", *own[1:]])  # of another machine: unknown


def test_a_driver_does_not_wait_for_the_driver_before_it(work):
    (a, _), (b, _) = worker(work, "a", is_driver=True), worker(work, "b", launch=2, is_driver=True)
    (c, _), (d, _) = worker(work, "c"), worker(work, "d", launch=2)
    a.take(CHUNK), c.take(OTHER)
    for each in (b, d):
        each.look()
    assert b.standing(CHUNK) is Standing.FREE and d.standing(CHUNK) is Standing.HELD
    assert b.standing(OTHER) is Standing.HELD  # a worker may go on when the driver is lost


def lose(work: Path, owner: str, *, commits: bool = False, launch: int = 1) -> Leases:
    """Another process takes the chunk and is lost."""
    leases, clock = worker(work, owner, launch=launch)
    leases.look()
    leases.standing(CHUNK)
    clock.now += SECONDS
    files = leases.take(CHUNK)
    if files is not None and commits:
        commit(files, owner)
    return leases


def test_a_chunk_that_loses_two_workers_has_failed(work):
    lose(work, "a", commits=True)
    lose(work, "b", commits=True)
    lose(work, "c")  # b had got on
    leases = lose(work, "d")
    assert leases.standing(CHUNK) is Standing.FAILED
    assert leases.attempts.reason(CHUNK) == "2 workers were lost, one after the other, while they ran it"
    assert parts(leases) == ["a", "b"]
    # The driver resumes the sweep, and the chunk is tried again.
    leases.attempts.unmark(CHUNK, leases.attempts.failed[CHUNK], "failed")
    assert lose(work, "e", launch=2).standing(CHUNK) is Standing.HELD


def test_a_failure_is_final_and_told_to_all(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    a.take(CHUNK)
    a.fail(CHUNK, "boom")
    b.look()
    assert b.standing(CHUNK) is Standing.FAILED and b.take(CHUNK) is None
    assert b.attempts.reason(CHUNK) == "boom"


def test_a_worker_lost_before_it_could_say_that_a_chunk_is_done(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    files = a.take(CHUNK)
    files.state.is_done = True
    commit(files, "all")
    a.give_back(CHUNK)
    assert b.take(CHUNK) is None and b.standing(CHUNK) is Standing.DONE
    assert parts(b) == ["all"]


def test_deleting_the_folder_of_an_attempt_forgets_how_it_ended(work):
    a, _ = worker(work, "a")
    files = a.take(CHUNK)
    commit(files, "bad")
    a.finish(CHUNK, {})
    for path in files.path.iterdir():
        path.unlink()
    files.path.rmdir()
    b, _ = worker(work, "b")
    b.look()
    assert b.standing(CHUNK) is Standing.FREE
    assert b.take(CHUNK).path == work / f"{CHUNK}-2"  # a number is never used twice


@pytest.mark.parametrize("name", ["lease", "heartbeat"])
@pytest.mark.parametrize("content", ["", "[1]", '{"beats": "x"}', '{"owner": "a"}'])
def test_a_damaged_lease_is_free(work, name, content):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    a.take(CHUNK)
    path = work / f"{CHUNK}-1" / "lease.json" if name == "lease" else work / "worker-a.json"
    path.write_text(content)
    b.look()
    assert b.standing(CHUNK) is Standing.FREE


def test_an_attempt_without_a_lease_is_waited_for(work):
    """Its owner has just begun, or was lost between two operations."""
    b, clock = worker(work, "b")
    (work / f"{CHUNK}-1").mkdir()
    b.look()
    assert b.standing(CHUNK) is Standing.HELD and not b.is_alive(CHUNK)
    clock.now += SECONDS
    assert b.standing(CHUNK) is Standing.FREE


def test_damaged_files_of_a_predecessor_are_named(work):
    (a, _), (b, _) = worker(work, "a"), worker(work, "b")
    files = a.take(CHUNK)
    commit(files, "half")
    a.give_back(CHUNK)
    (files.path / "part-000000-steps.parquet").write_text("")
    with pytest.raises(
        ResultsError, match=f"changed since it was written; delete the folder {files.path} and"
    ):
        b.take(CHUNK)


def test_where_there_are_no_links_files_are_copied(work, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    (a, _), (b, clock) = worker(work, "a"), worker(work, "b")
    commit(a.take(CHUNK), "half")
    b.look()
    b.standing(CHUNK)
    clock.now += SECONDS
    assert b.take(CHUNK).state.parts == 1 and parts(b) == ["half"]


def test_stray_files_are_no_attempts(work):
    for name in (f"{CHUNK}-1.tmp", f".{CHUNK}-1.done.tmp", "chunk-1-2", f"{CHUNK}", f"{CHUNK}-2.done"):
        (work / name).write_text("")
    write_json(work / "worker-x.json", {"beats": 1})
    attempts = Attempts(work)
    attempts.look()
    assert attempts.newest == {CHUNK: 2} and not attempts.complete and not attempts.heartbeats()
