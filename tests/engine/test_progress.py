"""Progress reports the runs done and the time left, without flooding a log."""

import io

import pytest
from rich.console import Console

from bojax.engine import progress
from bojax.engine.forecast import ChunkProgress, GroupProgress
from bojax.engine.progress import SweepProgress
from bojax.engine.runner import Segment
from bojax.text import duration


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

    monkeypatch.setattr(progress.time, "monotonic", lambda: Clock.now)
    return Clock


def make(num_runs=100, *, is_terminal=False, **options):
    console = Console(file=io.StringIO(), force_terminal=is_terminal, width=120)
    return SweepProgress("toy", num_runs, console=console, **options), console.file


def group_of(*waiting: int, name="toy", lanes=10, max_advances=20, compile_seconds: float | None = 1.0):
    chunks = {i: ChunkProgress(lanes, lanes, lanes, number, max_advances) for i, number in enumerate(waiting)}
    return GroupProgress(name, max_advances, chunks, compile_seconds=compile_seconds)


def segment(**changed) -> Segment:
    usual = {
        "finished": 0,
        "lanes": 10,
        "live": 10,
        "waiting": 0,
        "advances": 1,
        "lane_advances": 10,
        "advances_left": 10,
    }
    return Segment(**(usual | {"active_steps": 1, "issued_steps": 1, "seconds": 1.0} | changed))


def test_counts_rates_and_time_left(clock):
    shown, _ = make()
    group = group_of(70)
    shown.add([group], runs_done=20)
    clock.now += 4.0
    shown.segment(
        group,
        0,
        segment(
            finished=10,
            waiting=60,
            advances=4,
            lane_advances=40,
            active_steps=8000,
            issued_steps=10000,
            seconds=4.0,
        ),
    )
    # A run takes 4 advances of 1 s. The 60 waiting ones take 6 times 4 in 10 lanes, and the last of the 10 in
    # lanes 10 at most.
    assert shown.describe() == "30/100 runs, 2k steps/s, lanes 80% busy, 34 s left"
    shown.end_chunk(group, 0)
    assert shown.describe().endswith(", 0 s left")


def test_runs_of_earlier_processes_do_not_flatter_the_pace(clock):
    shown, _ = make(num_runs=40)
    group = group_of(0)
    shown.add([group], runs_done=30)
    assert shown.describe() == "30/40 runs"


def test_plain_lines_are_rare(clock):
    shown, text = make()
    group = group_of(0)
    shown.add([group])
    with shown:
        for _ in range(250):
            clock.now += 0.1
            shown.segment(group, 0, segment())
    assert len(text.getvalue().splitlines()) == 2


def test_compiling_is_shown_with_its_time(clock):
    shown, text = make()
    group, other = group_of(0, name="kcbts", compile_seconds=None), group_of(0, compile_seconds=None)
    with shown:
        shown.add([group, other])
        shown.compiling(group)
        shown.compiled(group, 4.21)
    assert text.getvalue().splitlines() == ["compiling kcbts ...", "compiled kcbts in 4.2 s"]
    # Of which nothing is known but that the first was compiled in no time: 10 s, and 3 s of runs each.
    assert shown.describe() == "0/100 runs, 1 of 2 programs to compile, 13 s left"


def test_the_time_left_is_shown_while_nothing_happens(clock):
    shown, text = make()
    with shown:
        shown.add([group_of(0, compile_seconds=None)])
        shown.compiling(shown._groups[0])
        for _ in range(15):
            clock.now += 1.0
            shown.tick()
    assert text.getvalue().splitlines()[1:] == ["toy: 0/100 runs, 1 of 1 programs to compile, 13 s left"]


def test_the_time_of_compilation_is_told_even_if_none_has_ended(clock):
    shown, _ = make()
    group = group_of(0, compile_seconds=None)
    shown.add([group])
    shown.compiling(group)
    clock.now += 9.0
    assert shown.describe_times() == "ran for 9 s: no program was compiled, runs advanced 0% of the time"
    shown.compiled(group, 9.0)
    clock.now += 3.0
    shown.segment(group, 0, segment(seconds=3.0))
    told = "ran for 12 s: the last program was compiled after 9 s, runs advanced 25% of the time"
    assert shown.describe_times() == told


def test_a_terminal_gets_a_bar(clock):
    shown, text = make(is_terminal=True)
    group = group_of(0, name="kcbts [x]")
    with shown:
        shown.add([group])
        shown.compiling(group)
        shown.segment(group, 0, segment())
    assert "\x1b[" in text.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (125.0, "2 min 05 s"), (7265.0, "2 h 01 min")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text
