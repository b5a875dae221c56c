"""The clock of threads that share the cores of a CPU with other processes."""

import pytest

from bojax.engine import clock
from bojax.engine.clock import MOST_MARKS, Clock


class Times:
    """Times of the wall and of the processor, which the tests set."""

    now = used = 0.0

    def monotonic(self):
        return self.now

    def process_time(self):
        return self.used


@pytest.fixture
def times(monkeypatch):
    times = Times()
    monkeypatch.setattr(clock, "time", times)
    monkeypatch.setattr(clock, "usable_cores", lambda: 2)
    return times


def advance(times, made, seconds, cores, busy):
    """Let threads be busy on so many cores, with a mark each second."""
    for _ in range(seconds):
        times.now += 1.0
        times.used += cores
        made.note(busy)


def test_threads_get_what_the_process_gets(times):
    made = Clock(shares_cores=True)
    advance(times, made, 10, cores=0.5, busy=1)  # another process has half of a core, while one stays idle
    assert made.between(2.0, 6.5) == pytest.approx(2.25) and made.share() == pytest.approx(0.5)
    advance(times, made, 20, cores=2.0, busy=4)
    assert made.between(0.0, 10.0) == pytest.approx(5.0)
    assert made.between(10.0, 30.0) == made.between(9.0, 30.0) - 0.5 == pytest.approx(10.0)
    assert made.share() == pytest.approx(1.0)  # of the last 15 s
    advance(times, made, 5, cores=0.0, busy=1)
    assert made.share() == pytest.approx((12.5 * 2.0) / (12.5 * 2.0 + 5.0), abs=0.05)


def test_a_thread_may_use_several_cores(times):
    made = Clock(shares_cores=True)
    advance(times, made, 20, cores=1.5, busy=1)
    assert made.between(10.0, 20.0) == pytest.approx(15.0) and made.share() == pytest.approx(1.5)


def test_a_clock_that_has_just_started_knows_nothing(times):
    made = Clock(shares_cores=True)
    made.note(1)
    assert made.share() == 1.0 and made.between(-1.0, 2.0) == 3.0


def test_elsewhere_it_is_the_time_of_the_wall(times):
    made = Clock()
    advance(times, made, 10, cores=0.5, busy=1)
    assert made.between(2.0, 6.5) == 4.5 and made.share() == 1.0


def test_the_number_of_marks_is_bounded(times):
    made = Clock(shares_cores=True)
    advance(times, made, 3 * MOST_MARKS, cores=0.5, busy=1)
    assert len(made._marks) <= MOST_MARKS
    assert made.between(10.0, times.now) == pytest.approx((times.now - 10.0) / 2)
    assert made.share() == pytest.approx(0.5)
