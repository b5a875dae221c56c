"""Progress reports the runs done and the time left, without flooding a log."""

import io

import pytest
from rich.console import Console

from bojax.engine import progress
from bojax.engine.progress import GroupProgress, SweepProgress
from bojax.engine.runner import Segment
from bojax.text import duration


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

    monkeypatch.setattr(progress.time, "monotonic", lambda: Clock.now)
    return Clock


def make(*names: str, num_runs=100, runs_done=0, is_terminal=False):
    text = io.StringIO()
    console = Console(file=text, force_terminal=is_terminal, width=120)
    shown = SweepProgress("toy", num_runs, console=console)
    groups = [GroupProgress(name) for name in names]
    shown.add(groups, runs_done)
    return shown, text, *groups


def segment(finished=0, active_steps=1, issued_steps=1, seconds=1.0) -> Segment:
    return Segment(finished, active_steps, issued_steps, seconds)


def test_runs_rates_and_time_left(clock):
    shown, _, group = make("toy", runs_done=20)
    shown.compiling(group)
    clock.now += 10.0
    shown.compiled(group, 10.0)
    assert shown.describe() == "20/100 runs"  # those of an earlier process tell no pace
    clock.now += 4.0
    shown.segment(group, segment(10, 8000, 10000, 4.0))
    # 10 runs in 4 s, and 70 are left; the seconds of the compilation do not count.
    assert shown.describe() == "30/100 runs, 28 s left, 2k steps/s, lanes 80% busy"
    shown.failed(group, 20, "broken")
    assert shown.describe().startswith("30/100 runs, 20 s left")
    clock.now += 26.0
    shown.segment(group, segment(50, seconds=1.0))
    assert shown.describe().startswith("80/100 runs, 0 s left")


def test_programs_that_are_left_may_take_longer_than_the_runs(clock):
    shown, text, group, *others = make("kcbts", "b", "c")
    for each in (group, *others):
        shown.compiling(each)
    clock.now += 30.0
    shown.compiled(group, 30.0)
    clock.now += 1.0
    shown.segment(group, segment(50))
    # 50 runs at 50 a second, but two programs at one in 31 s.
    assert shown.seconds_left() == 62.0
    assert shown.describe().endswith(", 2 of 3 programs to compile")
    shown.failed(others[0], 25, "no program")
    assert shown.seconds_left() == 31.0
    lines = text.getvalue().splitlines()
    assert lines[:4] == [
        "compiling kcbts ...",
        "compiling b ...",
        "compiling c ...",
        "compiled kcbts in 30.0 s",
    ]
    assert lines[-1] == "failed: b, 25 runs: no program"


def test_a_log_gets_a_line_in_ten_seconds(clock):
    shown, text, group = make("toy")
    for _ in range(250):
        clock.now += 0.1
        shown.segment(group, segment())
    for _ in range(12):  # also while nothing happens
        clock.now += 1.0
        shown.tick()
    assert len(text.getvalue().splitlines()) == 3


def test_a_terminal_gets_a_bar(clock):
    shown, text, group = make("kcbts [x]", is_terminal=True)
    with shown:
        shown.compiling(group)
        shown.segment(group, segment())
    assert "\x1b[" in text.getvalue()


def test_durations():
    cases = {0.4: "0 s", 59.6: "1 min 00 s", 125.0: "2 min 05 s", 7265.0: "2 h 01 min"}
    for seconds, text in cases.items():
        assert duration(seconds) == text


@pytest.mark.parametrize("seconds, after", [(1.0, 301.0), (60.0, 601.0)])
def test_a_note_says_once_that_no_run_advances(clock, seconds, after):
    shown, text, group = make("kcbts")
    clock.now += 10_000.0
    shown.tick()  # a long compilation is no reason
    for _ in range(2):
        shown.segment(group, segment(seconds=seconds))
        clock.now += after - 2.0
        shown.tick()
        assert "advanced" not in text.getvalue()
        clock.now += 2.0
        shown.tick()
        shown.tick()
        assert text.getvalue().count("note: no run has advanced for") == 1
        assert "--resume" in text.getvalue()
        text.truncate(0)
