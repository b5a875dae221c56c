"""Chunks: every run of every point exactly once, in queues of one size."""

import pytest

from bojax.engine.chunks import Layout, cut
from bojax.engine.groups import static_groups
from tests.toy import toy

CONFIGS = [{"scale": 1.0}, {"scale": 2.0}]


def cut_toy(queue, runs=range(5), configs=CONFIGS, **context):
    (group,) = static_groups([toy(**config) for config in CONFIGS])
    return cut(group, runs, Layout(queue, (queue,), 1), configs, context, first_index=7)


@pytest.mark.parametrize("queue", [1, 3, 10, 64])
def test_every_run_once(queue):
    chunks = cut_toy(queue)
    lanes = [lane for chunk in chunks for lane in zip(chunk.points, chunk.runs, strict=True)]
    assert lanes == [(point, run) for point in (0, 1) for run in range(5)]
    assert [chunk.index for chunk in chunks] == list(range(7, 7 + len(chunks)))
    assert all(chunk.num_runs <= queue for chunk in chunks)


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
