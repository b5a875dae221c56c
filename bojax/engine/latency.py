"""Latency of a single run, measured without a batch."""

import itertools
import time
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from bojax.engine.batch import run_key
from bojax.engine.devices import Device
from bojax.engine.groups import StaticGroup

LEAST_ADVANCES, MOST_ADVANCES = 6, 10
"""Minimum and maximum number of advances over which the median is taken.

The least and the largest of 6 contain the true median with a probability of 1 - 2^-5, 97%.
"""

BUDGET_SECONDS = 0.5
"""Time after which the measurement of a point ends, once it has the minimum number of advances."""


class Latency(NamedTuple):
    """Seconds of one advance of a single run: median, least and largest."""

    median: float
    least: float
    largest: float


def measure_latency(
    group: StaticGroup, points: Sequence[int], seed: int, device: Device
) -> dict[int, Latency]:
    """The latency of a single run, for each of the given points of the group.

    One pair of programs, compiled without a batch axis, serves all points. Once a run is done, the next run
    starts: advances of a finished run do nothing and are not measured.
    """

    def init(key, run, swept, shared):
        return group.experiment(swept, shared).init(run_key(key, run))

    def advance(carry, swept, shared):
        experiment = group.experiment(swept, shared)
        carry, records = experiment.advance(carry)
        return carry, records, experiment.is_done(carry)

    key, shared = jax.device_put((jax.random.key(seed), group.shared), device)
    swept = jax.device_put(group.swept_at(np.asarray(0)), device)
    compiled_init = jax.jit(init).lower(key, np.int32(0), swept, shared).compile()
    carry = jax.eval_shape(init, key, np.int32(0), swept, shared)
    compiled_advance = jax.jit(advance, donate_argnums=0).lower(carry, swept, shared).compile()
    latencies = {}
    for point in points:
        swept = jax.device_put(group.swept_at(np.asarray(group.points.index(point))), device)
        runs, is_done = itertools.count(), True
        times: list[float] = []
        start = time.perf_counter()
        while len(times) <= LEAST_ADVANCES or (
            len(times) <= MOST_ADVANCES and time.perf_counter() - start < BUDGET_SECONDS
        ):
            if is_done:
                carry = jax.block_until_ready(compiled_init(key, np.int32(next(runs)), swept, shared))
            before = time.perf_counter()
            carry, _, done = jax.block_until_ready(compiled_advance(carry, swept, shared))
            times.append(time.perf_counter() - before)
            is_done = bool(done)
        times = times[1:]  # the first advance warms up
        latencies[point] = Latency(float(np.median(times)), min(times), max(times))
    return latencies
