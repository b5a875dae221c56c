"""Latency of a single run, measured without a batch."""

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from bojax.engine import program_cache
from bojax.engine.ahead import Ahead
from bojax.engine.batch import obtain, run_key
from bojax.engine.devices import Device, of_platform
from bojax.engine.execute import compile_threads
from bojax.engine.groups import StaticGroup
from bojax.engine.program_cache import Program, Traced
from bojax.engine.progress import SweepProgress
from bojax.text import error_line

if TYPE_CHECKING:
    from bojax.engine.sweep_run import SweepRun

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


class Latencies:
    """The latencies that sweeps ask for: of the first point of each of their variants.

    Threads compile the programs as sweeps end. Times are measured once all runs have ended and all programs
    are compiled.

    Args:
        devices: The devices of all sweeps.
        stop: Whether a stop is requested.
    """

    def __init__(self, devices: Sequence[Device], stop: Callable[[], bool]):
        self._devices, self._stop = devices, stop
        self._asked: list[tuple[SweepRun, StaticGroup, list[int]]] = []

    @cached_property
    def _ahead(self) -> "Ahead[SingleRun]":
        return Ahead(compile_threads(), threading.Condition(threading.RLock()), self._stop)

    def compile(self, sweep_run: "SweepRun") -> None:
        """Compile what a sweep asks for, in threads."""
        plan = sweep_run.plan
        if not plan.sweep.engine.latency:
            return
        (device, *_) = of_platform(self._devices, plan.device["platform"])
        firsts = {(point.label, point.variant): point.index for point in reversed(plan.sweep.points)}
        for group in plan.groups:
            points = sorted(set(group.points) & set(firsts.values()))
            if points and not plan.experiment(group).is_hosted:
                self._ahead.request(len(self._asked), partial(SingleRun, group, plan.sweep.seed, device))
                self._asked.append((sweep_run, group, points))

    def measure(self, progress: SweepProgress) -> None:
        """Measure the latencies, and note them. A failure leaves the results complete."""
        if not self._asked:
            return
        progress.say("waiting for the programs of single runs, to measure their latency ...")
        for index in range(len(self._asked)):
            with contextlib.suppress(BaseException):  # told below; a Ctrl-C is a requested stop
                self._ahead.wait(index)
        for index, (sweep_run, group, points) in enumerate(self._asked):
            if self._stop():
                break
            name = sweep_run.plan.name(group)
            progress.timing(name)
            try:
                run = self._ahead.wait(index)
                sweep_run.note_latency(group, {point: run.latency(point) for point in points})
            except BaseException as error:
                progress.say(f"latency of {name} not measured: {error_line(error)}")
        self._ahead.close()


class SingleRun:
    """The programs of a single run of a static group, without a batch axis. They serve all its points.

    They are saved, like those of a batch.
    """

    def __init__(self, group: StaticGroup, seed: int, device: Device):
        self._group, self._device = group, device
        self._key, self._shared = jax.device_put((jax.random.key(seed), group.shared), device)
        key = program_cache.key_of(group, device, SingleRun)
        self._programs = obtain(key, device, self._trace).loaded.programs

    def _trace(self) -> Traced:
        """The programs, and the leaves of their carry."""

        def init(key, run, swept, shared):
            return self._group.experiment(swept, shared).init(run_key(key, run))

        def start(*inputs):
            return jax.tree.leaves(init(*inputs))

        def advance(carry, swept, shared):
            experiment = self._group.experiment(swept, shared)
            carry, records = experiment.advance(carry)
            return *map(jax.tree.leaves, (carry, records)), experiment.is_done(carry)

        first = self._key, np.int32(0), self._swept_at(self._group.points[0]), self._shared
        carry = jax.eval_shape(init, *first)
        return {
            "single_advance": Program.of_trees(advance, carry, *first[2:], donated=0),
            "single_init": Program.of_trees(start, *first),
        }, jax.tree.leaves(carry)

    def _swept_at(self, point: int) -> PyTree:
        position = np.asarray(self._group.points.index(point))
        return jax.device_put(self._group.swept_at(position), self._device)

    def latency(self, point: int) -> Latency:
        """The latency at a point.

        Once a run is done, the next run starts: advances of a finished run do nothing and are not measured.
        """
        init, advance = self._programs["single_init"], self._programs["single_advance"]
        swept, runs, is_done = self._swept_at(point), itertools.count(), True
        carry, times, fixed = [], [], jax.tree.leaves((swept, self._shared))
        start = time.perf_counter()
        while len(times) <= LEAST_ADVANCES or (
            len(times) <= MOST_ADVANCES and time.perf_counter() - start < BUDGET_SECONDS
        ):
            if is_done:
                run = np.int32(next(runs))
                carry = jax.block_until_ready(init(*jax.tree.leaves((self._key, run, swept, self._shared))))
            before = time.perf_counter()
            carry, _, done = jax.block_until_ready(advance(*carry, *fixed))
            times.append(time.perf_counter() - before)
            is_done = bool(done)
        times = times[1:]  # the first advance warms up
        return Latency(float(np.median(times)), min(times), max(times))
