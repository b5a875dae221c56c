"""The compiled programs of a static group: `vmap` over the lanes of one device.

A lane is one run of one point. Each device has its own lanes, and devices do not communicate.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.sharding import SingleDeviceSharding
from jax.stages import Compiled, Lowered
from jaxtyping import Array, Bool, Int, Key, PyTree

from bojax.engine import executables
from bojax.engine.devices import Device
from bojax.engine.groups import StaticGroup
from bojax.engine.protocol import check_advance, check_init, check_records, check_summary
from bojax.experiments.base import Carry, Experiment, Records
from bojax.numerics.lanes import LANES

compile_counts: Counter[str] = Counter()
"""Number of XLA compilations of the engine in this process, by program."""

TRACING = threading.Lock()
"""Tracing holds the interpreter's lock: the programs of one group are ready sooner if no other is traced."""


class Lanes(NamedTuple):
    """Inputs of the lanes, on the device.

    Attributes:
        runs: Index of each lane's run, from which its key is derived.
        swept: Leaves whose values differ between points.
    """

    runs: Int[Array, " lanes"]
    swept: PyTree


class Status(NamedTuple):
    """Progress after an advance.

    Attributes:
        is_done: Whether the run of each lane has finished.
        active_steps: Environment steps of the advance.
    """

    is_done: Bool[Array, " lanes"]
    active_steps: Int[Array, " lanes"]


class TracedOnce:
    """A function of one lane, traced once for batches of any number of lanes.

    Tracing runs Python for every operation. Batching what was traced takes a tenth to a half of that time.

    Args:
        function: A function of the inputs of one lane and of inputs that all lanes share. It may refer to the
            named axis `LANES`, but not to its size, which is 1 during tracing.
    """

    def __init__(self, function: Callable[[PyTree, PyTree], PyTree]):
        self._function = function
        self._traced: tuple[Callable[..., list[Array]], Any] | None = None

    def __call__(self, lanes: PyTree, shared: PyTree) -> PyTree:
        """The results of all lanes, whose inputs have a leading axis."""
        if self._traced is None:
            one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), lanes)
            trace = jax.make_jaxpr(self._function, axis_env=[(LANES, 1)], return_shape=True)
            traced, results = trace(one, shared)
            self._traced = jaxpr_as_fun(traced), jax.tree.structure(results)
        compute, structure = self._traced
        return jax.tree.unflatten(
            structure,
            jax.vmap(lambda one: compute(*jax.tree.leaves((one, shared))), axis_name=LANES)(lanes),
        )


class Functions:
    """The functions of a static group that are compiled for a number of lanes and a device.

    JAX keeps the trace of each, so that a second device costs no second tracing.
    """

    def __init__(self, group: StaticGroup):
        self.group, self.tag = group, executables.tag_of(group)
        self.init = TracedOnce(partial(_init, group))
        self.fill = self._jit("fill", partial(_fill, self.init), donate_argnums=1)
        self.advance = self._jit("advance", _in_lanes(_advance, group), donate_argnums=0)
        self.summary = self._jit("summary", _in_lanes(_summary, group))
        self.snapshot = self._jit("snapshot", _in_lanes(_snapshot, group))
        self.exported_state = self._jit("exported_state", _in_lanes(_exported_state, group))
        self.recorded = self._jit("recorded", _recorded)
        self.select = self._jit("select", _select)

    def empty(self, carry: PyTree[jax.ShapeDtypeStruct], device: Device):
        """A jitted function that makes a carry without values on a device."""
        return self._jit("empty", partial(_empty, carry), out_shardings=SingleDeviceSharding(device))

    def _jit(self, name: str, function: Callable, **options: Any):
        return named_jit(name, self.tag, function, **options)


def named_jit(name: str, tag: str, function: Callable, **options: Any):
    """A jitted function, under a name of its own for the group with this tag."""

    def call(*inputs):
        return function(*inputs)

    call.__name__ = f"{name}_{tag}"
    return jax.jit(call, **options)


class Programs:
    """The programs of one static group for a number of lanes on one device.

    Attributes:
        num_lanes: Number of lanes.
        device: The device.
        max_advances: Number of advances after which a run is done.
        compile_seconds: Seconds spent on tracing and compiling, or on loading.
        is_saved: Whether other devices and later sweeps can load the programs.
    """

    _is_compiled: ClassVar[bool] = True
    """Whether an advance is one compiled program."""

    def __init__(
        self,
        functions: Functions,
        device: Device,
        num_lanes: int,
        seed: int,
        *,
        recorded: int,
        wider: int | None = None,
        started: Callable[[], None] = lambda: None,
    ):
        """Compile the programs.

        Args:
            functions: The functions of the group.
            device: The device.
            num_lanes: Number of lanes.
            seed: Seed of the sweep.
            recorded: Largest number of lanes whose run is recorded.
            wider: The larger number of lanes that the runs come from; None if they start in these lanes.
            started: Called when tracing starts, after that of others, or when saved programs are loaded.
        """
        self.num_lanes, self.device = num_lanes, device
        self._functions, self._group = functions, functions.group
        self._sharding = SingleDeviceSharding(device)
        self._key = jax.device_put(jax.random.key(seed), self._sharding)
        self._shared = jax.device_put(self._group.shared, self._sharding)
        first = jax.device_put(self._group.swept_at(np.asarray(0)), self._sharding)
        run = self._group.experiment(first, self._shared)
        self.max_advances = run.max_advances
        self._recorded_tables, self._num_recorded = run.recorded_tables, min(recorded, num_lanes)
        self._prepare(run)
        key = self.key_of(self._group, device, num_lanes, self._num_recorded, wider)
        lower = partial(self._lower, wider)
        self._programs, carry, self.is_saved, self.compile_seconds = obtain(
            key, device, functions.tag, lower, started
        )
        self.carry_structure = on_device(carry, device)

    @classmethod
    def key_of(
        cls, group: StaticGroup, device: Device, num_lanes: int, recorded: int, wider: int | None
    ) -> str | None:
        """Name under which the programs are saved; None if they are not."""
        return executables.key_of(group, device, cls, num_lanes, min(recorded, num_lanes), wider)

    def _prepare(self, run: Experiment) -> None:
        """Prepare what a subclass needs of the first run."""

    def _lower(self, wider: int | None) -> tuple[dict[str, Lowered], PyTree[jax.ShapeDtypeStruct]]:
        """The programs, traced for inputs of exactly these shapes on this device, and their carry."""
        functions, one_point = self._functions, np.zeros(self.num_lanes, dtype=np.int32)
        lanes = self.place(one_point, one_point)
        carry = jax.eval_shape(functions.init, lanes, (self._key, self._shared))
        inputs = (on_device(carry, self.device), lanes, self._shared)
        lowered = {"advance": functions.advance.lower(*inputs)} if self._is_compiled else {}
        lowered["summary"] = functions.summary.lower(*inputs)
        if self._num_recorded and jax.tree.leaves(jax.eval_shape(functions.snapshot, *inputs)):
            lowered["snapshot"] = functions.snapshot.lower(*inputs)
        if self._num_recorded and self._recorded_tables and self._is_compiled:
            _, tables, _ = lowered["advance"].out_info
            lowered["recorded"] = functions.recorded.lower(
                on_device({name: tables[name] for name in self._recorded_tables}, self.device),
                jax.device_put(np.zeros(self._num_recorded, np.int32), self._sharding),
            )
        if wider is not None:
            of_wider = jax.tree.map(lambda leaf: leaf.update(shape=(wider, *leaf.shape[1:])), carry)
            lowered["select"] = functions.select.lower(on_device(of_wider, self.device), lanes.runs)
        else:
            everywhere = jax.device_put(np.ones(self.num_lanes, dtype=bool), self._sharding)
            lowered["empty"] = functions.empty(carry, self.device).lower()
            lowered["fill"] = functions.fill.lower(self._key, inputs[0], lanes, everywhere, self._shared)
        return lowered, carry

    def place(self, positions: np.ndarray, runs: np.ndarray) -> Lanes:
        """Put the inputs of all lanes on the device.

        Args:
            positions: For each lane, the position of its point among the points of the group.
            runs: For each lane, the index of its run.
        """
        lanes = (runs.astype(np.int32), self._group.swept_at(positions))
        return Lanes(*jax.device_put(lanes, self._sharding))

    def init(self, lanes: Lanes) -> Carry:
        """The carry of every lane before its first advance."""
        return self.fill(self._programs["empty"](), lanes, np.ones(self.num_lanes, dtype=bool))

    def fill(self, carry: Carry, lanes: Lanes, is_new: np.ndarray) -> Carry:
        """Start the runs of some lanes; the buffers of the given carry are donated."""
        is_new = jax.device_put(is_new, self._sharding)
        return self._programs["fill"](self._key, carry, lanes, is_new, self._shared)

    def advance(self, carry: Carry, lanes: Lanes) -> tuple[Carry, dict[str, dict[str, Array]], Status]:
        """Advance every lane once; the buffers of the given carry are donated."""
        return self._programs["advance"](carry, lanes, self._shared)

    def recorded(self, tables: Mapping[str, dict[str, Array]], lanes: np.ndarray) -> dict[str, Any]:
        """The tables of an advance, where the tables of recorded runs keep the given lanes only.

        These lanes come first; further ones pad the columns to one length, so that one program serves any
        number of lanes.

        Args:
            tables: Tables of an advance, columns `[lanes, rows]`.
            lanes: The lanes whose runs are recorded.
        """
        of_runs = {name: columns for name, columns in tables.items() if name in self._recorded_tables}
        if not len(lanes):
            kept = jax.tree.map(lambda column: np.empty((0, *column.shape[1:]), column.dtype), of_runs)
        else:
            select = self._programs.get("recorded", self._functions.recorded)
            padded = np.resize(lanes, self._num_recorded).astype(np.int32)
            kept = select(of_runs, jax.device_put(padded, self._sharding)) if of_runs else {}
        return {**tables, **kept}

    def summary(self, carry: Carry, lanes: Lanes) -> dict[str, Array]:
        """The summary of every lane."""
        return self._programs["summary"](carry, lanes, self._shared)

    def snapshot(self, carry: Carry, lanes: Lanes) -> dict[str, dict[str, Array]]:
        """The snapshot of every lane; empty if the experiment has none or if no run is recorded."""
        if "snapshot" not in self._programs:
            return {}
        return self._programs["snapshot"](carry, lanes, self._shared)

    def exported_state(self, carry: Carry, lanes: Lanes) -> PyTree:
        """The state of every lane that a saved learner is restored from."""
        return self._functions.exported_state(carry, lanes, self._shared)

    def select(self, carry: Carry, lanes: np.ndarray) -> Carry:
        """The carry of some of the lanes of `wider`."""
        return self._programs["select"](carry, jax.device_put(lanes.astype(np.int32), self._sharding))


def on_device(structure: PyTree[jax.ShapeDtypeStruct], device: Device) -> PyTree[jax.ShapeDtypeStruct]:
    """The structure of arrays on a device."""
    sharding = SingleDeviceSharding(device)
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), structure
    )


class Obtained(NamedTuple):
    """The programs of a group, loaded or compiled.

    Attributes:
        programs: The programs. A call with inputs of another shape or on another device raises.
        carry: The structure of their carry, without shardings.
        is_saved: Whether other devices and later sweeps can load them.
        seconds: Seconds of loading, or of tracing and compiling.
    """

    programs: dict[str, Compiled]
    carry: PyTree[jax.ShapeDtypeStruct]
    is_saved: bool
    seconds: float


def obtain(
    key: str | None,
    device: Device,
    tag: str,
    lower: Callable[[], tuple[dict[str, Lowered], PyTree[jax.ShapeDtypeStruct]]],
    started: Callable[[], None] = lambda: None,
) -> Obtained:
    """Load the programs of a group, or trace, compile and save them.

    Args:
        key: Name under which they are saved; None if they are not.
        device: The device.
        tag: The `executables.tag_of` the group.
        lower: Traces them; returns them with the structure of their carry.
        started: Called when tracing starts, after that of others, or when saved programs are loaded.
    """
    start = time.perf_counter()
    if found := executables.load(key, device):
        programs, carry = found
        are_saved, seconds = True, time.perf_counter() - start
        started()
    else:
        with TRACING:
            started()
            executables.drop_damaged(tag)
            start = time.perf_counter()
            lowered, carry = lower()
            traced = time.perf_counter() - start
        start = time.perf_counter()
        programs, are_saved = _compile(lowered, key, device)
        seconds = traced + time.perf_counter() - start
        are_saved = key is not None and are_saved and executables.save(key, programs.keys(), carry)
    executables.hold(key, device, (programs, carry))
    return Obtained(programs, carry, are_saved, seconds)


def _compile(
    lowered: Mapping[str, Lowered], key: str | None, device: Device
) -> tuple[dict[str, Compiled], bool]:
    """Compiled or saved programs, and whether all are saved under the key."""
    programs, are_saved = dict[str, Compiled](), True
    for name, each in lowered.items():
        program = executables.load_program(key, name, device)
        if program is None:
            with executables.compiled_anew() as anew:
                program = each.compile()
            compile_counts[name] += 1
            # Now, since after its first call XLA no longer serialises a program with a sort for the CPU.
            are_saved &= bool(anew) and key is not None and executables.save_program(key, name, program)
        programs[name] = program
    return programs, are_saved


def run_key(key: Key[Array, ""], run: Int[Array, ""]) -> Key[Array, ""]:
    """The key of a run, equal at every point of a sweep, so that comparisons are paired by run."""
    return jax.random.fold_in(key, run)


def _init(group: StaticGroup, lane: Lanes, key_and_shared: tuple[Key[Array, ""], PyTree]) -> Carry:
    key, shared = key_and_shared
    experiment = group.experiment(lane.swept, shared)
    carry = experiment.init(run_key(key, lane.runs))
    check_init(experiment, carry)
    return carry


def _fill(init: TracedOnce, key, carry: Carry, lanes: Lanes, is_new, shared: PyTree) -> Carry:
    def choose(fresh, old):
        return jnp.where(is_new.reshape(-1, *[1] * (old.ndim - 1)), fresh, old)

    return jax.tree.map(choose, init(lanes, (key, shared)), carry)


def _in_lanes(function: Callable[[Experiment, Carry], PyTree], group: StaticGroup):
    """Batch a function of an experiment and its carry over the lanes."""

    def of_one_lane(lane: tuple[Carry, PyTree], shared: PyTree) -> PyTree:
        carry, swept = lane
        return function(group.experiment(swept, shared), carry)

    in_lanes = TracedOnce(of_one_lane)
    return lambda carry, lanes, shared: in_lanes((carry, lanes.swept), shared)


def _advance(experiment: Experiment, carry: Carry):
    return checked_advance(experiment, carry, *experiment.advance(carry))


def checked_advance(experiment: Experiment, before: Carry, after: Carry, records: Records):
    """Check an advance of one lane; returns its carry, its tables and its status."""
    check_advance(experiment, before, after)
    check_records(experiment, records.tables)
    return after, records.tables, Status(experiment.is_done(after), records.active_steps)


def _summary(experiment: Experiment, carry: Carry) -> dict[str, Array]:
    summary = experiment.summary(carry)
    check_summary(experiment, summary)
    return summary


def _snapshot(experiment: Experiment, carry: Carry) -> dict[str, dict[str, Array]]:
    return experiment.snapshot(carry)


def _exported_state(experiment: Experiment, carry: Carry) -> PyTree:
    return experiment.exported_state(carry)


def _recorded(tables: PyTree, lanes: Int[Array, " recorded"]) -> PyTree:
    return jax.tree.map(lambda column: column[lanes], tables)


def _select(carry: Carry, lanes: Int[Array, " selected"]) -> Carry:
    return jax.tree.map(lambda leaf: leaf[lanes], carry)


def _empty(structure: PyTree[jax.ShapeDtypeStruct]) -> Carry:
    return jax.tree.map(jnp.empty_like, structure)
