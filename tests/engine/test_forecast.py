"""The forecast, on batches whose runs end at a constant rate, or all at the same advance."""

import numpy as np
import pytest

from bojax.engine.clock import Clock
from bojax.engine.forecast import (
    CHUNK,
    COMPILATION,
    EXPECTED_SHARE,
    LONGER,
    OWN_PACE,
    ChunkProgress,
    GroupProgress,
    forecast,
)

PACE = 0.5
"""Seconds of an advance."""

USUAL = {"now": 0.0, "workers": {"cpu": 1}, "threads": 2, "clock": Clock()}


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
        seen.append(found)
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


def test_nothing_is_forecast_before_the_first_compilation():
    group = GroupProgress("toy", 10, {0: ChunkProgress(4, 4, 4, 0, 10)})
    assert forecast([group], **USUAL) is None


def test_the_chunks_of_a_group_are_taken_to_last_as_long_as_one_that_has_ended():
    """Of two chunks of ten runs, the second has begun, with episodes that are longer than the late ones."""
    ended = ChunkProgress(10, 10, 0, 0, 0, 0.1, runs=10, seconds=30.0)
    begun = ChunkProgress(10, 10, 10, 0, 90, 2.0, runs=10)
    group = GroupProgress("toy", 100, {0: ended, 1: begun}, seconds=50.0, advances=110)
    group.finished, group.lane_advances, group.compile_seconds = 10, 1100, 1.0
    group.end(0)
    # At its own pace, its 90 advances take 180 s, which counts more and more.
    for begun.seconds, done in ((0.0, 0.0), (20.0, 20 / 200), (90.0, 90 / 270)):
        found, weight = forecast([group], **USUAL), done**OWN_PACE
        whole = 30.0 ** (1 - weight) * (begun.seconds + 180.0) ** weight
        assert found == pytest.approx(max(whole - begun.seconds, weight * 180.0))


def test_chunks_that_have_not_begun_are_taken_to_last_as_long_as_one_that_has():
    begun = ChunkProgress(10, 10, 10, 0, 1, 2.0, runs=10, seconds=38.0)  # of 40 s
    new = ChunkProgress(10, 10, 10, 0, 20, runs=10)
    group = GroupProgress("toy", 20, {0: new, 1: begun}, seconds=38.0, advances=19, compile_seconds=1.0)
    own = 0.95**OWN_PACE
    for expected in (None, 0.1, 4.0, 100.0):
        group.expected_run = expected
        # What is expected counts for the first chunk, and as two of twelve runs for the second.
        first = 40.0 if expected is None else (10 * expected) ** (1 - own) * 40.0**own
        second = first if expected is None else 10 * (2 * expected + first) / 12
        found = forecast([group], **USUAL)
        assert EXPECTED_SHARE * 20 == 2 and found == pytest.approx(second + max(first - 38.0, 2.0 * own))


def test_runs_of_equal_length_pass_through_the_lanes_in_rounds():
    """Ten runs of 20 advances in eight lanes: the last two take as long as the first eight."""
    chunk = ChunkProgress(8, 8, 8, 2, 15, PACE, runs=10, seconds=5 * PACE)
    group = GroupProgress("toy", 20, {0: chunk}, seconds=5 * PACE, advances=5, compile_seconds=1.0)
    assert forecast([group], **USUAL) == pytest.approx((15 + 20) * PACE)


def waiting(name="waiting", chunks=1, **options):
    """A group without an advance."""
    left = {i: ChunkProgress(1, 1, 1, 0, 10, runs=1) for i in range(chunks)}
    return GroupProgress(name, 10, left, **options)


def ended(seconds, chunks=1, **options):
    """A group whose chunks, of one run each, have ended."""
    options = {"ended_chunks": chunks, "ended_runs": chunks, "ended_seconds": seconds} | options
    return GroupProgress("ended", 10, seconds=seconds, advances=10, **options)


def test_a_compilation_and_a_chunk_are_taken_for_usual_ones_before_any_has_ended():
    first, second, third = waiting(compiling_since=-5.0), waiting(compiling_since=-1.0), waiting(chunks=2)
    found = forecast([first, second, third], **USUAL)
    # The third is compiled after the first.
    assert found == pytest.approx((COMPILATION - 5.0) + COMPILATION + 2 * CHUNK)


def test_a_compilation_that_lasts_longer_than_others_is_taken_to_go_on():
    known = ended(1.0, compiling_since=-90.0, compiled=-80.0, compile_seconds=10.0)
    usual = (COMPILATION + 10.0) / 2
    for age, expected in ((usual - 4.0, 4.0), (40.0, 40.0 * (LONGER - 1.0))):
        found = forecast([known, waiting(compiling_since=-age)], **USUAL)
        assert found == pytest.approx(expected + 1.0)  # and a run as long as the known one


def test_a_group_of_which_nothing_is_known_is_taken_for_the_geometric_mean_of_others():
    # A chunk of the first takes 4 s, and one of the second 9 s, whatever the number of their advances.
    groups = [ended(8.0, 2, compiling_since=-9.0), ended(9.0), waiting(chunks=3, compile_seconds=1.0)]
    found = forecast(groups, **USUAL)
    assert found == pytest.approx(3 * 6.0)


def test_a_group_that_runs_counts_with_what_it_still_takes():
    begun = ChunkProgress(1, 1, 1, 0, 6, seconds_per_advance=2.0)
    known = GroupProgress("known", 10, {0: begun}, seconds=8.0, advances=4)
    found = forecast([known, waiting(compile_seconds=1.0)], **USUAL)
    assert found == pytest.approx(12.0 + 20.0)


def test_threads_compile_one_group_after_the_other_with_all_its_programs():
    """Six programs in two threads; of each group, the first one lets it run."""
    options = {"expected_run": 1.0, "platform": "gpu", "programs": 2}
    groups = [waiting(compiling_since=0.0, **options), waiting(**options), waiting(**options)]
    found = forecast(groups, now=0.0, workers={"gpu": 1}, threads=2, clock=Clock())
    assert found == pytest.approx(3 * COMPILATION + 1.0)


@pytest.mark.parametrize(("count", "rounds"), [(1, 1.0), (2, 1.0), (3, 1.5)])
def test_programs_of_single_runs_are_compiled_at_the_end(count, rounds):
    groups = [waiting(compile_seconds=COMPILATION, expected_run=5.0, is_timed=i < count) for i in range(4)]
    groups[0].compiling_since = -1.0
    assert forecast(groups, **USUAL) == pytest.approx(4 * 5.0 + rounds * COMPILATION)


def test_a_device_waits_for_the_programs():
    """Two groups of 5 s, ready after 0 and 12 s; then one of which two chunks run side by side."""
    options = {"expected_run": 5.0, "platform": "gpu"}
    late = waiting(compiling_since=12.0 - COMPILATION, **options)
    groups = [waiting(compile_seconds=1.0, **options), late]
    for workers, chunks, expected in ((1, 1, 17.0), (1, 4, 20.0 + 5.0), (2, 2, 17.0)):
        groups[0] = waiting(chunks=chunks, compile_seconds=COMPILATION, **options)
        found = forecast(groups, now=0.0, workers={"gpu": workers}, threads=2, clock=Clock())
        assert found == pytest.approx(expected)


def test_platforms_run_side_by_side():
    for seconds, expected in ((3.0, 4.0), (5.0, 5.0)):  # of the CPU, then of the GPU
        groups = [
            waiting(platform="gpu", compile_seconds=1.0, compiling_since=-1.0, expected_run=seconds),
            waiting(platform="cpu", compile_seconds=1.0, expected_run=2.0),
            waiting(platform="cpu", compile_seconds=1.0, expected_run=4.0),
        ]
        found = forecast(groups, now=0.0, workers={"gpu": 1, "cpu": 8}, threads=2, clock=Clock())
        assert found == pytest.approx(expected)


def test_a_run_is_taken_to_last_as_in_an_earlier_sweep():
    group = waiting(chunks=2, compile_seconds=1.0, compiling_since=-1.0, expected_run=6.0)
    found = forecast([group], **USUAL)
    assert found == pytest.approx(12.0)
    # Half of the time as expected_run has passed, in three times as long: the rest takes twice as long.
    found = forecast(
        [ended(18.0, compiling_since=-1.0, expected_run=6.0), waiting(expected_run=6.0)], **USUAL
    )
    assert found == pytest.approx(COMPILATION + 12.0)


# Fig. 4.4 on one H200, twice: of each group, when its compilation and its only chunk began and ended.
COLD = {
    "kcbts": (0.1, 43.9, 44.0, 45.4),
    "gps-abt": (0.0, 22.5, 24.9, 31.4),
    "sbo-5": (0.1, 22.5, 22.5, 24.5),
    "sbo-9": (0.1, 41.0, 41.0, 42.3),
    "sbo-17": (0.1, 43.9, 45.4, 46.7),
    "random": (0.1, 29.8, 32.1, 35.0),
    "kcbts-copies": (0.1, 44.0, 46.7, 48.2),
}
WARM = {
    "kcbts": (0.0, 2.8, 8.7, 10.2),
    "gps-abt": (0.0, 3.4, 4.0, 7.1),
    "sbo-5": (0.0, 2.7, 7.1, 8.7),
    "sbo-9": (0.0, 2.7, 2.7, 3.9),
    "sbo-17": (0.0, 2.8, 10.2, 11.4),
    "random": (0.0, 2.1, 2.1, 2.2),
    "kcbts-copies": (0.0, 2.9, 11.4, 12.9),
}


def ratios(recorded, earlier, shares):
    """Forecast over truth at shares of the time of a recorded sweep."""
    total = max(times[-1] for times in recorded.values())
    for now in shares * total:
        groups = []
        for name, (compiling, compiled, begun, end) in recorded.items():
            group = waiting(name, platform="gpu", compiling_since=compiling)
            group.expected_run = None if earlier is None else earlier[name][3] - earlier[name][2]
            if compiled <= now:
                group.compiled, group.compile_seconds = compiled, compiled - compiling
            if end <= now:
                group.chunks[0].live, group.chunks[0].seconds = 0, end - begun
                group.seconds, group.advances = end - begun, 10
                group.end(0)
            groups.append(group)
        found = forecast(groups, now=now, workers={"gpu": 1}, threads=2, clock=Clock())
        assert found is not None
        yield found / (total - now)


@pytest.mark.parametrize(("recorded", "earlier"), [(COLD, None), (COLD, WARM), (WARM, COLD)])
def test_a_recorded_sweep_is_forecast_within_a_factor_of_two_most_of_the_time(recorded, earlier):
    found = np.array(list(ratios(recorded, earlier, np.linspace(0.1, 0.9, 17))))
    # Before the first is compiled, nothing tells cold from warm; the last compilation may end at any time.
    assert np.mean((found > 0.5) & (found < 2.0)) >= 0.7


def test_the_last_runs_take_less_time_in_fewer_lanes():
    def left(narrowest):
        chunk = ChunkProgress(4000, narrowest, 100, 0, 1000, seconds_per_advance=1.0)
        group = GroupProgress(
            "toy", 1000, {0: chunk}, finished=3900, lane_advances=39000, compile_seconds=1.0
        )
        group.seconds, group.advances = 10.0, 10
        found = forecast([group], **USUAL)
        assert found is not None
        return found

    harmonic = np.sum(1 / np.arange(1, 101))
    assert left(4000) == pytest.approx(10 * harmonic)
    # Of 100 runs left in 4,000 lanes: an advance of the k last ones takes k / 4,000 of the time.
    assert left(1) == pytest.approx(10 * 100 / 4000)
    assert left(1) < left(63) < left(500) < left(4000)
