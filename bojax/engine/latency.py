"""Latency of a single run: one lane by itself, which a batch cannot tell."""

import itertools
import time
from collections.abc import Sequence

import jax
import numpy as np

from bojax.engine.batch import run_key
from bojax.engine.devices import Device
from bojax.engine.groups import StaticGroup

LEAST, MOST = 3, 10
"""Fewest and most advances of which the median is taken."""

BUDGET_SECONDS = 0.5
"""Time for one point, once the fewest advances are measured."""


def measure_latency(group: StaticGroup, points: Sequence[int], seed: int, device: Device) -> dict[int, float]:
    """Median seconds of one advance at batch 1, for each of these points of the group.

    One pair of programs is compiled, without a batch axis, and serves all points. Advances of finished
    runs are not counted: the next run is begun instead.
    """

    def init(key, run, swept, shared):
        return group.experiment(swept, shared).init(run_key(key, run))

    def advance(carry, swept, shared):
        experiment = group.experiment(swept, shared)
        carry, records = experiment.advance(carry)
        return carry, records, experiment.is_done(carry)

    key, shared = jax.device_put((jax.random.key(seed), group.shared), device)
    swept = jax.device_put(group.swept_at(np.asarray(0)), device)
    begin = jax.jit(init).lower(key, np.int32(0), swept, shared).compile()
    carry = jax.eval_shape(init, key, np.int32(0), swept, shared)
    go_on = jax.jit(advance, donate_argnums=0).lower(carry, swept, shared).compile()
    latencies = {}
    for point in points:
        swept = jax.device_put(group.swept_at(np.asarray(group.points.index(point))), device)
        runs, is_done = itertools.count(), True
        times: list[float] = []
        start = time.perf_counter()
        while len(times) <= LEAST or (len(times) <= MOST and time.perf_counter() - start < BUDGET_SECONDS):
            if is_done:
                carry = jax.block_until_ready(begin(key, np.int32(next(runs)), swept, shared))
            begun = time.perf_counter()
            carry, _, done = jax.block_until_ready(go_on(carry, swept, shared))
            times.append(time.perf_counter() - begun)
            is_done = bool(done)
        latencies[point] = float(np.median(times[1:]))  # the first one warms up
    return latencies
