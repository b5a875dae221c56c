"""A compiled static group: `vmap` over the lanes of a device, `shard_map` over devices.

A lane is one run of one point. Each device advances its own lanes; devices do not communicate.
"""

import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Int, Key, PyTree

from bojax.engine.devices import DEVICES
from bojax.engine.groups import StaticGroup
from bojax.engine.protocol import VALID, check_advance, check_init, check_records, check_summary
from bojax.experiments.base import Carry, Experiment, Records
from bojax.numerics.lanes import LANES

compile_counts: Counter[str] = Counter()
"""Number of XLA compilations of the engine in this process, by program."""

BY_LANE, REPLICATED = PartitionSpec(DEVICES), PartitionSpec()
"""Placement of an array: divided among the devices by lane, or replicated on every device."""


class Lanes(NamedTuple):
    """Inputs of the lanes of a chunk, on the devices.

    Attributes:
        runs: Index of each lane's run, from which its key is derived.
        is_real: False for lanes that only pad the chunk.
        swept: Leaves whose values differ between points.
    """

    runs: Int[Array, " lanes"]
    is_real: Bool[Array, " lanes"]
    swept: PyTree


class Status(NamedTuple):
    """Progress after an advance, summed over the real lanes of each device.

    Attributes:
        remaining: Number of lanes that are not done.
        active_steps: Environment steps of the advance.
    """

    remaining: Int[Array, " devices"]
    active_steps: Int[Array, " devices"]


class Compiled:
    """The programs of one static group at a fixed number of lanes.

    Attributes:
        num_lanes: Number of lanes of a chunk, on all devices together.
        max_advances: Number of advances after which every lane is done.
        compile_seconds: Seconds spent on tracing and compiling.
    """

    def __init__(self, group: StaticGroup, mesh: Mesh, lanes_per_device: int, seed: int, *, snapshots: bool):
        start = time.perf_counter()
        self.num_lanes = lanes_per_device * mesh.size
        self._group = group
        self._by_lane = NamedSharding(mesh, BY_LANE)
        everywhere = NamedSharding(mesh, REPLICATED)
        self._key = jax.device_put(jax.random.key(seed), everywhere)
        self._shared = jax.device_put(group.shared, everywhere)
        one_point = np.zeros(self.num_lanes, dtype=np.int32)
        lanes = self.place(one_point, one_point, np.ones(self.num_lanes, dtype=bool))

        compiled = partial(_compile, mesh=mesh)
        init = partial(_init, group)
        carry = jax.eval_shape(init, self._key, lanes, self._shared)
        self.carry_structure = jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=self._by_lane), carry
        )
        self._init = compiled(init, (REPLICATED, BY_LANE, REPLICATED), self._key, lanes, self._shared)
        inputs = (self.carry_structure, lanes, self._shared)
        specs = (BY_LANE, BY_LANE, REPLICATED)
        self._advance = self._compile_advance(compiled, specs, *inputs)
        self._summary = compiled(partial(_summary, group), specs, *inputs)
        snapshot = partial(_snapshot, group)
        has_snapshot = snapshots and bool(jax.tree.leaves(jax.eval_shape(snapshot, *inputs)))
        self._snapshot = compiled(snapshot, specs, *inputs) if has_snapshot else None

        self.max_advances = group.experiment(lanes.swept, self._shared).max_advances
        self.compile_seconds = time.perf_counter() - start

    def _compile_advance(self, compiled: Callable, specs: tuple, *inputs: Any) -> Any:
        return compiled(partial(_advance, self._group), specs, *inputs, donate=True)

    def place(self, positions: np.ndarray, runs: np.ndarray, is_real: np.ndarray) -> Lanes:
        """Put the inputs of `num_lanes` lanes on the devices.

        Args:
            positions: For each lane, the position of its point among the points of the group.
            runs: For each lane, the index of its run.
            is_real: For each lane, whether it is more than padding.
        """
        lanes = (runs.astype(np.int32), is_real, self._group.swept_at(positions))
        return Lanes(*jax.device_put(lanes, self._by_lane))

    def init(self, lanes: Lanes) -> Carry:
        """The carry of every lane before its first advance."""
        return self._init(self._key, lanes, self._shared)

    def advance(self, carry: Carry, lanes: Lanes) -> tuple[Carry, dict[str, dict[str, Array]], Status]:
        """Advance every lane once; the buffers of the given carry are donated."""
        return self._advance(carry, lanes, self._shared)

    def summary(self, carry: Carry, lanes: Lanes) -> dict[str, Array]:
        """The summary of every lane."""
        return self._summary(carry, lanes, self._shared)

    def exported_state(self, carry: Carry, lanes: Lanes) -> PyTree:
        """The state of every lane that a saved learner is restored from."""
        return jax.jit(partial(_exported_state, self._group))(carry, lanes, self._shared)

    def snapshot(self, carry: Carry, lanes: Lanes) -> dict[str, dict[str, Array]]:
        """The snapshot of every lane; empty if the experiment has none or if snapshots are not kept."""
        return {} if self._snapshot is None else self._snapshot(carry, lanes, self._shared)


def _exported_state(group: StaticGroup, carry: Carry, lanes: Lanes, shared: PyTree) -> PyTree:
    def one(carry, swept):
        return group.experiment(swept, shared).exported_state(carry)

    return jax.vmap(one, axis_name=LANES)(carry, lanes.swept)


def run_key(key: Key[Array, ""], run: Int[Array, ""]) -> Key[Array, ""]:
    """The key of a run, equal at every point of a sweep, so that comparisons are paired by run."""
    return jax.random.fold_in(key, run)


def _init(group: StaticGroup, key: Key[Array, ""], lanes: Lanes, shared: PyTree) -> Carry:
    def one(run, swept):
        experiment = group.experiment(swept, shared)
        carry = experiment.init(run_key(key, run))
        check_init(experiment, carry)
        return carry

    return jax.vmap(one, axis_name=LANES)(lanes.runs, lanes.swept)


def _advance(group: StaticGroup, carry: Carry, lanes: Lanes, shared: PyTree):
    def one(carry, is_real, swept):
        experiment = group.experiment(swept, shared)
        return checked_advance(experiment, carry, *experiment.advance(carry), is_real)

    carry, tables, is_done, active_steps = jax.vmap(one, axis_name=LANES)(carry, lanes.is_real, lanes.swept)
    return carry, tables, status_of(is_done, active_steps, lanes.is_real)


def checked_advance(
    experiment: Experiment, before: Carry, after: Carry, records: Records, is_real: Bool[Array, ""]
):
    """Check an advance of one lane; returns its carry, its tables, whether it is done, and its steps."""
    check_advance(experiment, before, after)
    check_records(experiment, records.tables)
    tables = {name: {**columns, VALID: columns[VALID] & is_real} for name, columns in records.tables.items()}
    return after, tables, experiment.is_done(after), records.active_steps


def status_of(
    is_done: Bool[Array, " lanes"], active_steps: Int[Array, " lanes"], is_real: Bool[Array, " lanes"]
) -> Status:
    """The status of the lanes of one device."""
    return Status(
        remaining=jnp.sum(~is_done & is_real, keepdims=True),
        active_steps=jnp.sum(jnp.where(is_real, active_steps, 0), keepdims=True),
    )


def _summary(group: StaticGroup, carry: Carry, lanes: Lanes, shared: PyTree) -> dict[str, Array]:
    def one(carry, swept):
        experiment = group.experiment(swept, shared)
        summary = experiment.summary(carry)
        check_summary(experiment, summary)
        return summary

    return jax.vmap(one, axis_name=LANES)(carry, lanes.swept)


def _snapshot(group: StaticGroup, carry: Carry, lanes: Lanes, shared: PyTree) -> dict[str, dict[str, Array]]:
    def one(carry, swept):
        return group.experiment(swept, shared).snapshot(carry)

    return jax.vmap(one, axis_name=LANES)(carry, lanes.swept)


def _compile(function: Callable, in_specs: tuple, *inputs: Any, mesh: Mesh, donate: bool = False) -> Callable:
    """Compile for inputs of exactly these shapes and shardings; a call with any other input raises."""
    # The loop carry of an experiment may begin as a replicated constant and become a value of the lane, which
    # `check_vma` would refuse. The check protects communication between devices, and there is none.
    sharded = jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=BY_LANE, check_vma=False)
    program = jax.jit(sharded, donate_argnums=0 if donate else ()).lower(*inputs).compile()
    compile_counts[function.func.__name__.lstrip("_")] += 1  # type: ignore[attr-defined]
    return program
