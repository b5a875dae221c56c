"""Results that threads compute ahead."""

import threading

import pytest

from bojax.engine.ahead import Ahead, Stopped


@pytest.fixture
def ahead():
    found = Ahead(1, threading.Condition(threading.RLock()), lambda: False)
    yield found
    found.close()


def hold(ahead) -> threading.Event:
    """Keep the only thread busy until an event."""
    begun, event = threading.Event(), threading.Event()
    ahead.request("first", lambda: (begun.set(), event.wait(60.0)))
    assert begun.wait(60.0)
    return event


def test_a_result_that_is_dropped_before_its_turn_is_not_computed(ahead):
    computed = []
    event = hold(ahead)
    ahead.request("dropped", lambda: computed.append("dropped"))
    ahead.request("last", lambda: computed.append("last"), 1)
    ahead.drop("dropped")
    event.set()
    ahead.wait("last")
    assert computed == ["last"] and not ahead.is_requested("dropped")


def test_the_calling_thread_does_not_wait_for_the_others(ahead):
    event = hold(ahead)
    ahead.compute("mine", threading.get_ident)
    assert ahead.wait("mine") == threading.get_ident()
    ahead.compute("mine", lambda: pytest.fail("computed twice"))
    event.set()


def test_an_error_is_raised_by_each_who_waits(ahead):
    ahead.request("wrong", lambda: 1 // 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            ahead.wait("wrong")


def test_nobody_waits_after_a_requested_stop():
    has_stopped = threading.Event()
    ahead = Ahead(1, threading.Condition(threading.RLock()), has_stopped.is_set)
    event = hold(ahead)
    has_stopped.set()
    with pytest.raises(Stopped):
        ahead.wait("first")
    event.set()
