"""The forecast, on batches whose runs end at a constant rate, or all at the same advance."""

import numpy as np
import pytest

from bojax.engine.forecast import ChunkProgress, GroupProgress, forecast

PACE = 0.5
"""Seconds of an advance."""

USUAL = {"now": 0.0, "workers": {"cpu": 1}}


def simulate(lengths: np.ndarray, lanes: int, most: int):
    """The forecast and the truth after every advance of a queue in so many lanes."""
    waiting, left = list(lengths[lanes:]), list(lengths[:lanes])
    ages = [0] * len(left)
    group = GroupProgress("toy", most, compile_seconds=1.0)
    chunk = group.chunks[0] = ChunkProgress(lanes, lanes, len(left), len(waiting), most)
    seen = []
    while left:
        group.advances += 1
        group.seconds += PACE
        group.lane_advances += len(left)
        left, ages = [each - 1 for each in left], [age + 1 for age in ages]
        ended = sum(each == 0 for each in left)
        kept = [(each, age) for each, age in zip(left, ages, strict=True) if each]
        kept += [(waiting.pop(0), 0) for _ in range(min(ended, len(waiting)))]
        left, ages = [each for each, _ in kept], [age for _, age in kept]
        group.finished += ended
        chunk.live, chunk.waiting, chunk.seconds_per_advance = len(left), len(waiting), PACE
        chunk.advances_left = most - min(ages, default=0)
        found = forecast([group], **USUAL)
        assert found is not None
        seen.append(found.seconds)
    total = PACE * len(seen)
    return [(seconds, total - PACE * (i + 1)) for i, seconds in enumerate(seen)]


@pytest.mark.parametrize(
    ("mean", "most", "lanes"), [(20, 400, 8), (60, 60, 16), (10, 1000, 200), (5, 15, 16)]
)
def test_the_time_left_is_within_a_factor_of_two_after_a_tenth(mean, most, lanes):
    good = []
    for seed in range(20):
        draw = np.random.default_rng(seed)
        lengths = np.minimum(draw.geometric(1 / mean, 200), most) if mean < most else np.full(200, most)
        seen = simulate(lengths, lanes, most)
        # Towards the end it depends on how long the last few runs take, which nothing tells.
        good += [truth / 2 <= left <= 2 * truth for left, truth in seen[len(seen) // 10 : len(seen) // 2]]
    assert np.mean(good) > 0.9


def test_nothing_is_forecast_before_the_first_advance():
    group = GroupProgress("toy", 10, {0: ChunkProgress(4, 4, 4, 0, 10)})
    assert forecast([group], **USUAL) is None


def test_the_chunks_of_a_group_are_taken_to_last_as_long_as_one_that_has_ended():
    """Of two chunks of ten runs, the second has begun, with episodes that are longer than the late ones."""
    ended = ChunkProgress(10, 10, 0, 0, 0, 0.1, runs=10, seconds=30.0)
    begun = ChunkProgress(10, 10, 10, 0, 90, 2.0, runs=10, seconds=20.0)
    group = GroupProgress("toy", 100, {0: ended, 1: begun}, seconds=50.0, advances=110)
    group.finished, group.lane_advances, group.compile_seconds = 10, 1100, 1.0
    for expected in (10.0, 180.0):  # later, it has taken longer: 90 advances at its own pace
        group.end(0)
        found = forecast([group], **USUAL)
        assert found is not None and found.seconds == pytest.approx(expected)
        begun.seconds = 31.0


def test_an_unknown_group_is_taken_for_an_average_one():
    known = GroupProgress("known", 10, seconds=8.0, advances=4, ended_chunks=2, compile_seconds=3.0)
    known.compiling_since, known.compiled = -3.0, 0.0
    # Its advances may be much quicker than those of the known group.
    unknown = GroupProgress("unknown", 1000, {i: ChunkProgress(1, 1, 1, 0, 1000) for i in range(3)})
    found = forecast([known, unknown], **USUAL)
    assert found is not None
    assert found.running == pytest.approx(3 * 4.0)  # a chunk of the known group took 4 s
    assert found.compiling == pytest.approx(3.0)
    assert found.seconds == pytest.approx(15.0)


def test_a_group_that_runs_counts_with_what_it_still_takes():
    begun = ChunkProgress(1, 1, 1, 0, 6, seconds_per_advance=2.0)
    known = GroupProgress("known", 10, {0: begun}, seconds=8.0, advances=4)
    unknown = GroupProgress("unknown", 10, {0: ChunkProgress(1, 1, 1, 0, 10)})
    found = forecast([known, unknown], **USUAL)
    assert found is not None
    assert found.running == pytest.approx(12.0 + 20.0)


def test_workers_share_chunks_and_a_compilation_hides_behind_an_accelerator():
    chunks = {i: ChunkProgress(1, 1, 1, 0, 10, seconds_per_advance=1.0) for i in range(4)}
    group = GroupProgress("toy", 10, chunks, seconds=1.0, advances=1, compile_seconds=2.0, platform="gpu")
    group.compiling_since, group.compiled = -4.0, -2.0
    left = {9: ChunkProgress(1, 1, 1, 0, 10)}
    other = GroupProgress("other", 10, left, compiling_since=-1.0, platform="gpu")
    found = forecast([group, other], now=0.0, workers={"gpu": 2})
    assert found is not None
    assert found.running == pytest.approx(
        (4 * 10.0 + 41.0 / 4) / 2
    )  # the fifth chunk lasts as long as the others
    assert found.compiling == pytest.approx(4.0 / 1.5 * 0.5)  # one and a half programs took 4 s
    assert found.seconds == pytest.approx(found.running)


def test_compilations_side_by_side_are_forecast_by_how_far_they_have_come():
    def compiling(since, until=None):
        ended = {} if until is None else {"compiled": until, "compile_seconds": until - since}
        left = {0: ChunkProgress(1, 1, 1, 0, 1)}
        return GroupProgress("toy", 1, left, compiling_since=since, advances=1, seconds=0.0, **ended)

    first, second, late = compiling(0.0, 10.0), compiling(0.0), compiling(None)
    for now, expected in ((10.0, 10.0 / 1.9 * 1.1), (30.0, 30.0 / 1.9 * 1.1)):  # never taken as done
        found = forecast([first, second, late], now=now, workers={"cpu": 2})
        assert found is not None and found.compiling == pytest.approx(expected)


def test_a_device_that_waits_for_programs_is_taken_to_go_on_waiting_until_the_last_one():
    left = {0: ChunkProgress(1, 1, 1, 0, 10)}
    group = GroupProgress("toy", 10, left, seconds=5.0, advances=5, platform="gpu")
    group.begun, group.compile_seconds = -20.0, 1.0
    last = GroupProgress("last", 10, compiling_since=-20.0, platform="gpu")
    usual = {"now": 0.0, "workers": {"gpu": 2}}
    without = forecast([group, last], **usual)
    last.chunks[1] = ChunkProgress(1, 1, 1, 0, 10)
    waiting = forecast([group, last], **usual)
    assert without is not None and waiting is not None
    assert without.running == pytest.approx(10.0)  # one chunk, of ten advances
    assert waiting.running == pytest.approx((10 + 15) / 2 / (5 / (20 * 2)))


def test_platforms_run_side_by_side():
    def group(platform, seconds):
        left = {0: ChunkProgress(1, 1, 1, 0, 10)}
        return GroupProgress("toy", 10, left, seconds=seconds, advances=1, platform=platform)

    groups = [group("gpu", 3.0), group("cpu", 2.0), group("cpu", 4.0)]
    for groups[0].seconds, expected in ((3.0, 40.0), (5.0, 50.0)):  # of the CPU, then of the GPU
        found = forecast(groups, now=0.0, workers={"gpu": 1, "cpu": 8})
        assert found is not None
        assert found.running == pytest.approx(expected)
        assert not found.shares_cores


def test_the_last_runs_take_less_time_in_fewer_lanes():
    def left(narrowest):
        chunk = ChunkProgress(4000, narrowest, 100, 0, 1000, seconds_per_advance=1.0)
        group = GroupProgress(
            "toy", 1000, {0: chunk}, finished=3900, lane_advances=39000, compile_seconds=1.0
        )
        group.seconds, group.advances = 10.0, 10
        found = forecast([group], **USUAL)
        assert found is not None
        return found.seconds

    harmonic = np.sum(1 / np.arange(1, 101))
    assert left(4000) == pytest.approx(10 * harmonic)
    # Of 100 runs left in 4,000 lanes: an advance of the k last ones takes k / 4,000 of the time.
    assert left(1) == pytest.approx(10 * 100 / 4000)
    assert left(1) < left(63) < left(500) < left(4000)
