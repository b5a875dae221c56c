"""Progress reports the runs done and the time left, without flooding a log."""

import io
from functools import partial

import numpy as np
import pytest
from rich.console import Console

from bojax.engine import progress
from bojax.engine.clock import Clock
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
    assert shown.describe() == "30/100 runs, 34 s left, 2k steps/s, lanes 80% busy"
    shown.end_chunk(group, 0)
    assert shown.describe().startswith("30/100 runs, 0 s left")


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
    # Of which nothing is known but that the first was compiled in 4.2 s: 12.1 s, and 3 s of runs each.
    assert shown.describe() == "0/100 runs, 15 s left, 1 of 2 programs to compile"


@pytest.mark.parametrize(("platform", "expected"), [("cpu", 5.0), ("gpu", 1.0)])
def test_a_chunk_on_a_cpu_takes_the_time_of_its_first_state_and_of_its_files(clock, platform, expected):
    shown, _ = make()
    group = group_of(0)
    group.platform, group.chunks[0].runs, group.chunks[0].begun = platform, 10, clock.now
    shown.add([group])
    clock.now += 3.0
    shown.segment(group, 0, segment(finished=10, live=0, seconds=1.0))
    clock.now += 2.0
    shown.end_chunk(group, 0)
    assert group.ended_seconds == expected


def test_the_time_left_is_shown_while_nothing_happens(clock):
    shown, text = make()
    with shown:
        shown.add([group_of(0, compile_seconds=None)])
        shown.compiling(shown._groups[0])
        for _ in range(15):
            clock.now += 1.0
            shown.tick()
    assert text.getvalue().splitlines()[1:] == ["toy: 0/100 runs, 13 s left, 1 of 1 programs to compile"]


def test_the_time_of_compilation_is_told_even_if_none_has_ended(clock):
    shown, _ = make()
    group = group_of(0, compile_seconds=None)
    shown.add([group])
    shown.compiling(group)
    clock.now += 9.0
    assert shown.describe_times() == "ran for 9 s: no group was ready, runs advanced 0% of the time"
    shown.compiled(group, 9.0)
    clock.now += 3.0
    shown.segment(group, 0, segment(seconds=3.0))
    told = "ran for 12 s: the last group was ready after 9 s, runs advanced 25% of the time"
    assert shown.describe_times() == told


# The first sweep of Fig. 4.6 on two cores of which other processes took three quarters: for each group its
# runs, and what its compilation and a run take on a reference machine; then compilations (True when one has
# ended) and chunks (their wall time); and the processor time of the process, every 5 s.
PARKING = {
    "sbo": (200, 13.6, 0.0164),
    "gps-abt": (200, 17.4, 0.0499),
    "kcbts": (100, 10.7, 0.0429),
    "random": (100, 7.8, 0.0009),
}
EVENTS = [
    *[(0.0, "sbo", False), (0.0, "gps-abt", False), (45.8, "sbo", True), (45.8, "kcbts", False)],
    *[(47.1, "sbo", 1.25), (47.4, "sbo", 1.46), (49.3, "sbo", 2.05), (49.9, "sbo", 2.34)],
    *[(50.1, "gps-abt", True), (50.1, "random", False), (58.1, "gps-abt", 7.85), (58.3, "gps-abt", 7.94)],
    *[(73.0, "gps-abt", 14.31), (73.5, "gps-abt", 14.88), (90.7, "random", True)],
    *[(90.8, "random", 0.05), (90.9, "random", 0.02), (90.9, "random", 0.05), (90.9, "random", 0.01)],
    *[(93.1, "kcbts", True), (95.0, "kcbts", 1.92), (95.9, "kcbts", 2.78), (97.6, "kcbts", 2.45)],
    (97.7, "kcbts", 1.74),
]
USED = [0.0, 2.5, 4.9, 7.4, 10.5, 13.9, 17.1, 20.2, 23.2, 26.6, 31.0]
USED += [34.0, 36.7, 39.2, 41.8, 44.3, 46.9, 49.4, 52.0, 54.5, 57.0]


def test_the_first_sweep_on_a_busy_machine_is_forecast_within_a_factor_of_two(clock, monkeypatch):
    start, end = clock.now, EVENTS[-1][0]
    used = partial(np.interp, xp=5.0 * np.arange(len(USED)), fp=USED)
    monkeypatch.setattr(progress.time, "process_time", lambda: used(clock.now - start))
    monkeypatch.setattr("bojax.engine.clock.usable_cores", lambda: 2)
    shown, _ = make(workers={"cpu": 2}, threads=2, clock=Clock(shares_cores=True))
    groups = {}
    for name, (runs, compilation, run) in PARKING.items():
        chunks = {i: ChunkProgress(16, 16, 16, 0, 15, runs=runs // 4) for i in range(4)}
        groups[name] = GroupProgress(name, 15, chunks, expected_compilation=compilation, expected_run=run)
    shown.add([*groups.values()])
    ratios, events = [], list(EVENTS)
    for now in np.linspace(0.02, 0.98, 49) * end:
        while events and events[0][0] <= now:
            at, name, what = events.pop(0)
            clock.now = start + at
            if what is False:
                shown.compiling(groups[name])
            elif what is True:
                shown.compiled(groups[name], start + at - (groups[name].compiling_since or start))
            else:
                chunk = next(iter(groups[name].chunks))
                done = segment(finished=PARKING[name][0] // 4, live=0, advances_left=0, seconds=what)
                shown.segment(groups[name], chunk, done)
                shown.end_chunk(groups[name], chunk)
        clock.now = start + now
        shown.tick()
        found = shown.seconds_left()
        assert found is not None
        ratios.append(found / (end - now))
    assert 0.5 < min(ratios[5:46]) and max(ratios[5:46]) < 2.0  # from a tenth to nine tenths of the time


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
