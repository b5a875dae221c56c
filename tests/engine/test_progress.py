"""Progress reports the runs done and the time left, without flooding a log."""

import io

import pytest
from rich.console import Console

from bojax.engine import progress
from bojax.engine.progress import SweepProgress


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

    monkeypatch.setattr(progress.time, "monotonic", lambda: Clock.now)
    return Clock


def make(num_lanes=100, *, is_terminal=False):
    console = Console(file=io.StringIO(), force_terminal=is_terminal, width=120)
    return SweepProgress("toy", num_lanes, console), console.file


def test_counts_rates_and_time_left(clock):
    shown, _ = make(num_lanes=100)
    shown.skip(20)
    shown.start_chunk(40, 0.0)
    shown.segment(share=0.25, runs=3, steps=5000, seconds=2.0, busy=60, issued=80)
    # 10 of the 80 lanes' worth of work that are left at the start took 2 s: 70 are left.
    assert shown.describe() == "23/100 runs, 2.5k steps/s, lanes 75% busy, 14 s left"
    shown.end_chunk()
    assert shown.describe().startswith("60/100 runs")


def test_a_resumed_chunk_does_not_flatter_the_pace(clock):
    shown, _ = make(num_lanes=40)
    shown.start_chunk(40, 0.5)
    assert shown.describe() == "0/40 runs, 0 steps/s, lanes 100% busy"
    shown.segment(share=0.75, runs=0, steps=10, seconds=3.0, busy=1, issued=1)
    assert shown.describe().endswith("3 s left")


def test_plain_lines_are_rare(clock):
    shown, text = make()
    with shown:
        shown.start_chunk(100, 0.0)
        for i in range(250):
            clock.now += 0.1
            shown.segment(share=i / 250, runs=0, steps=1, seconds=0.1, busy=1, issued=1)
    assert len(text.getvalue().splitlines()) == 2


def test_compiling_is_shown_with_its_time(clock):
    shown, text = make()
    with shown:
        shown.compiling("kcbts")
        shown.compiled("kcbts", 4.21)
    assert text.getvalue().splitlines() == ["compiling kcbts ...", "compiled kcbts in 4.2 s"]


def test_a_terminal_gets_a_bar(clock):
    shown, text = make(is_terminal=True)
    with shown:
        shown.compiling("kcbts [x]")
        shown.segment(share=0.0, runs=0, steps=1, seconds=1.0, busy=1, issued=1)
    assert "\x1b[" in text.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (125.0, "2 min 05 s"), (7265.0, "2 h 01 min")]
)
def test_durations(seconds, text):
    assert progress._duration(seconds) == text
