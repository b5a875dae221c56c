"""Chunks: every run of every point exactly once, in batches of one size."""

import numpy as np
import pytest

from bojax.engine.chunks import cut
from bojax.engine.devices import choose_lanes
from bojax.engine.groups import static_groups
from tests.toy import toy

CONFIGS = [{"scale": 1.0}, {"scale": 2.0}]


def cut_toy(num_lanes, runs=range(5), configs=CONFIGS, **context):
    (group,) = static_groups([toy(**config) for config in CONFIGS])
    return cut(group, runs, num_lanes, configs, context, first_index=7)


@pytest.mark.parametrize("num_lanes", [1, 3, 10, 64])
def test_every_run_once(num_lanes):
    chunks = cut_toy(num_lanes)
    lanes = [lane for chunk in chunks for lane in zip(chunk.points, chunk.runs, strict=True)]
    assert lanes == [(point, run) for point in (0, 1) for run in range(5)]
    assert [chunk.index for chunk in chunks] == list(range(7, 7 + len(chunks)))
    assert all(chunk.num_lanes <= num_lanes for chunk in chunks)


def test_padding_repeats_real_lanes():
    chunk = cut_toy(8)[1]
    positions, runs, is_real = chunk.padded(8)
    assert is_real.tolist() == [True] * 2 + [False] * 6
    assert runs.tolist() == [3, 4] * 4 and positions.tolist() == [1] * 8


def test_point_of_a_chunk():
    assert [chunk.point for chunk in cut_toy(5)] == [0, 1]
    assert [chunk.point for chunk in cut_toy(10)] == [-1]


def test_identity_is_of_all_that_rows_depend_on():
    first, second = cut_toy(5)
    assert first.identity != second.identity
    assert first.identity == cut_toy(5)[0].identity
    assert first.identity != cut_toy(5, seed=1)[0].identity
    other = cut_toy(5, configs=[{"scale": 3.0}, CONFIGS[1]])
    assert other[0].identity != first.identity and other[1].identity == second.identity


@pytest.mark.parametrize(
    ("num_lanes", "num_devices", "given", "expected"),
    [
        (200, 1, None, 200),  # all in one chunk
        (200, 2, None, 100),
        (600, 2, None, 150),  # two even chunks, not one of 512 and one of 88
        (200, 1, 64, 64),  # the given number, so that bits can be compared
        (3, 8, None, 1),
    ],
)
def test_lanes_per_device(num_lanes, num_devices, given, expected):
    assert choose_lanes(num_lanes, num_devices, 256, given) == expected


def test_defaults_waste_few_lanes():
    for num_lanes in np.arange(1, 3000, 37).tolist():
        lanes = choose_lanes(num_lanes, 4, 64, None)
        chunks = -(-num_lanes // (4 * lanes))
        assert chunks * 4 * lanes - num_lanes < 4 * chunks
