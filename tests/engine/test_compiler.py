"""Programs that threads compile ahead; here they are numbers, and keys are tasks by rank."""

import threading
from types import SimpleNamespace

import pytest

from bojax.engine import compiler
from bojax.engine.batch import Programs
from bojax.engine.compiler import BackgroundCompiler
from bojax.engine.errors import Stopped
from bojax.engine.tasks import ProgramKey
from tests.engine.test_scheduler import Task


class Compiled(Programs):
    def __init__(self, *, is_saved: bool):
        self.is_saved = is_saved


@pytest.fixture
def made(monkeypatch):
    """A compiler of one thread, which is busy until `release` is set, and the keys that it has compiled."""
    monkeypatch.setattr(compiler, "compile_threads", lambda: 1)
    begun, release, has_stopped, compiled = threading.Event(), threading.Event(), threading.Event(), []

    def compile(key: ProgramKey) -> Programs:
        compiled.append((key, threading.get_ident()))
        if key.width == 0:
            begun.set()
            assert release.wait(60.0)
        return Compiled(is_saved=key.width == 1)

    found = BackgroundCompiler(compile, threading.Condition(threading.RLock()), has_stopped.is_set)
    found.request(key_of(0))
    assert begun.wait(60.0)
    yield SimpleNamespace(compiler=found, release=release, has_stopped=has_stopped, compiled=compiled)
    release.set()
    found.close()


def key_of(width: int, rank: int = 0, device: str = "first") -> ProgramKey:
    return ProgramKey(TASKS[rank], device, width)


TASKS = [Task(str(rank), 1, 4, rank=rank) for rank in range(3)]


def test_the_first_groups_come_first_and_dropped_ones_not_at_all(made):
    last, dropped, first = key_of(1, 2), key_of(2, 1), key_of(3, 0)
    for key in (last, dropped, first, last):
        made.compiler.request(key)
    made.compiler.drop(dropped)
    assert not made.compiler.is_requested(dropped) and made.compiler.is_requested(last)
    made.release.set()
    made.compiler.wait(last)
    assert [key for key, _ in made.compiled] == [key_of(0), first, last]
    assert made.compiler.is_ready(last) and made.compiler.error(last) is None


def test_what_is_not_needed_yet_comes_last_and_is_compiled_once(made):
    later, soon, first = key_of(1, 0), key_of(2, 1), key_of(3, 2)
    for key in (later, soon):
        made.compiler.request(key, is_needed=False)
    made.compiler.request(first)
    made.compiler.request(soon)  # it is needed now
    made.release.set()
    made.compiler.wait(later)
    assert [key for key, _ in made.compiled] == [key_of(0), soon, first, later]


def test_programs_are_loaded_by_the_thread_that_needs_them(made):
    source, unsaved = key_of(1), key_of(2)
    made.compiler.request(source)
    made.compiler.request(unsaved)
    made.release.set()
    other, requested = source._replace(device="other"), unsaved._replace(device="other")
    made.compiler.load(other, source)
    assert (other, threading.get_ident()) in made.compiled
    made.compiler.load(requested, unsaved)  # it cannot be loaded
    made.compiler.wait(requested)
    (thread,) = (thread for key, thread in made.compiled if key == requested)
    assert thread != threading.get_ident()


def test_an_error_is_raised_by_each_who_waits(made):
    wrong = key_of(-1)
    made.compiler._compile = lambda key: 1 // 0
    made.compiler.request(wrong)
    made.release.set()
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            made.compiler.wait(wrong)
    assert isinstance(made.compiler.error(wrong), ZeroDivisionError)


def test_nobody_waits_after_a_requested_stop(made):
    made.has_stopped.set()
    with pytest.raises(Stopped):
        made.compiler.wait(key_of(0))
    with pytest.raises(Stopped):
        made.compiler.load(key_of(0, device="other"), key_of(0))
