"""The compiled programs of a static group: `vmap` over the lanes of one device.

A lane is one run of one point. Each device has its own lanes, and devices do not communicate.
"""

import functools
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
from jaxtyping import Array, Bool, Int, Key, PyTree, UInt

from bojax.engine import executables, program_cache
from bojax.engine.autotuning import Choices, compile_again, contents_of
from bojax.engine.devices import Device, on_cpu
from bojax.engine.gpu_clients import needed_memory
from bojax.engine.groups import StaticGroup, nodes_with
from bojax.engine.program import GAINS, Program
from bojax.engine.program_cache import FOUND, WRITTEN, Loaded, Traced
from bojax.engine.protocol import check_advance, check_init, check_records, check_summary
from bojax.engine.xla_choices import offer_shipped
from bojax.experiments.base import Carry, Experiment, Records
from bojax.numerics.lanes import LANES

Leaves = Any
"""The leaves of a carry, as a list: programs take and return it without the structure of the experiment's."""

compile_counts: Counter[str] = Counter()
"""Number of XLA compilations of the engine in this process, by program."""

TRACING = threading.Lock()
"""Tracing holds the interpreter's lock: the programs of one group are ready sooner if no other is traced."""


class Lanes(NamedTuple):
    """Inputs of the lanes, on the device."""

    runs: Int[Array, " lanes"]  # index of each lane's run, from which its key is derived
    swept: PyTree  # leaves whose values differ between points


class Status(NamedTuple):
    """Progress after an advance."""

    is_done: Bool[Array, " lanes"]  # whether the run of each lane has finished
    active_steps: Int[Array, " lanes"]  # environment steps of the advance


class TracedOnce:
    """A function of inputs of one lane and of all, traced once for batches of any number of lanes.

    Tracing runs Python for every operation. Batching what was traced takes a tenth to a half of that time.
    The function may refer to the named axis `LANES`, but not to its size, which is 1 during tracing.
    """

    def __init__(self, function: Callable[[PyTree, PyTree], PyTree]):
        self._function = function
        self._traced: tuple[Callable[..., list[Array]], Any] | None = None

    def __call__(self, lanes: PyTree, shared: PyTree) -> PyTree:
        """The results of all lanes, whose inputs have a leading axis."""
        if self._traced is None:
            one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), lanes)
            trace = jax.make_jaxpr(self._function, axis_env=[(LANES, 1)], return_shape=True)
            # The axis is there for the name, which `any_lane` needs; the `vmap` below binds the name to the
            # true number of lanes.
            traced, results = trace(one, shared)
            self._traced = jaxpr_as_fun(traced), jax.tree.structure(results)
        compute, structure = self._traced
        return jax.tree.unflatten(
            structure, jax.vmap(lambda one: compute(*jax.tree.leaves((one, shared))), axis_name=LANES)(lanes)
        )


class Functions:
    """The functions of a static group, batched over the lanes.

    Each is traced once for one lane, so that a second number of lanes costs little.
    """

    def __init__(self, group: StaticGroup):
        self.group = group
        self.init = TracedOnce(partial(_init, group))
        self.fill = partial(_fill, self.init)
        self.advance = _in_lanes(_advance, group)
        self.summary = _in_lanes(_summary, group)
        self.snapshot = _in_lanes(lambda experiment, carry: experiment.snapshot(carry), group)
        # Not compiled ahead: most sweeps save no learners.
        self.exported_state = jax.jit(
            _in_lanes(lambda experiment, carry: experiment.exported_state(carry), group)
        )


class Programs:
    """The programs of one static group for a number of lanes on one device."""

    max_advances: int  # number of advances after which a run is done
    compile_seconds: float  # spent on tracing and compiling, or on loading
    is_saved: bool  # whether other devices and later sweeps can load the programs
    _is_compiled: ClassVar[bool] = True  # whether an advance is one compiled program

    def __init__(
        self,
        functions: Functions,
        device: Device,
        num_lanes: int,
        seed: int,
        *,
        recorded: int,
        wider: int | None = None,
        choices: Choices | None = None,
        started: Callable[[], None] = lambda: None,
    ):
        """Compile the programs.

        `recorded` is the largest number of lanes whose run is recorded, `wider` the larger number of lanes
        that the runs come from; None if they start in these. `started` is called when tracing starts, one
        group at a time, or when saved programs are loaded.
        """
        self.num_lanes, self.device = num_lanes, device
        self._functions, self._group = functions, functions.group
        self._sharding = SingleDeviceSharding(device)
        self._key = jax.random.wrap_key_data(jax.device_put(_key_data(seed), self._sharding))
        self._shared = jax.device_put(self._group.shared, self._sharding)
        first = jax.device_put(self._group.swept_at(np.asarray(0)), self._sharding)
        run = self._group.experiment(first, self._shared)
        self.max_advances = run.max_advances
        self._recorded_tables, self._num_recorded = run.recorded_tables, min(recorded, num_lanes)
        self._prepare(run)
        key = self.key_of(self._group, device, num_lanes, self._num_recorded, wider)
        offer_shipped(device)  # before XLA compiles and chooses for itself
        if choices is not None:
            choices.offer()
        loaded, self.is_saved, self.compile_seconds = obtain(
            key, device, partial(self._trace, wider), started, are_remade=choices is not None
        )
        self.carry_structure = [
            jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=self._sharding) for leaf in loaded.carry
        ]
        self._programs = dict(loaded.programs)
        if choices is not None:
            for name, program in loaded.programs.items():
                self._programs[name] = choices.settle(
                    f"{self._group.index}-{num_lanes}-{name}",
                    program,
                    lambda given, name=name: compile_again(loaded.traced(name), device, given),
                    loaded.contents.get(name),
                )

    @classmethod
    def key_of(
        cls, group: StaticGroup, device: Device, num_lanes: int, recorded: int, wider: int | None
    ) -> str | None:
        """Name under which the programs are saved; None if they are not."""
        return program_cache.key_of(group, device, cls, num_lanes, min(recorded, num_lanes), wider)

    def _prepare(self, run: Experiment) -> None:
        """Prepare what a subclass needs of the first run."""

    def _trace(self, wider: int | None) -> Traced:
        """The programs for inputs of exactly these shapes, and the leaves of their carry."""
        functions, lanes = self._functions, self._no_lanes()
        carry = self._carry_of(lanes)
        inputs = carry, lanes, self._shared
        programs = {}
        if self._is_compiled:
            gains = [name for name in GAINS if nodes_with(self._group.static, name)]
            programs["advance"] = Program.of_trees(functions.advance, *inputs, donated=0, gains=gains)
        programs["summary"] = Program.of_trees(functions.summary, *inputs)
        if self._num_recorded and jax.tree.leaves(jax.eval_shape(functions.snapshot, *inputs)):
            programs["snapshot"] = Program.of_trees(functions.snapshot, *inputs)
        if self._num_recorded and self._recorded_tables and self._is_compiled:
            _, tables, _ = jax.eval_shape(functions.advance, *inputs)
            recorded = {name: tables[name] for name in self._recorded_tables}
            programs["recorded"] = Program.of_trees(
                _recorded, recorded, np.zeros(self._num_recorded, np.int32)
            )
        if wider is not None:
            of_wider = jax.tree.map(lambda leaf: leaf.update(shape=(wider, *leaf.shape[1:])), carry)
            programs["select"] = Program.of_trees(_select, of_wider, lanes.runs)
        else:
            # A new batch is an empty one whose lanes are all new: one program starts runs, at once or later.
            everywhere = np.ones(self.num_lanes, dtype=bool)
            programs["empty"] = Program.of_trees(partial(_empty, carry))
            programs["fill"] = Program.of_trees(
                functions.fill, self._key, carry, lanes, everywhere, self._shared, donated=1
            )
        return programs, jax.tree.leaves(carry)

    @property
    def needed_memory(self) -> int | None:
        """Number of bytes of the device that a batch needs at most; None if it is not known.

        Of a batch whose environments step on the host, only the carry is counted.
        """
        return needed_memory(self._programs.values())

    def _no_lanes(self) -> Lanes:
        """Inputs of all lanes, of the shapes that the programs take."""
        one_point = np.zeros(self.num_lanes, dtype=np.int32)
        return self.place(one_point, one_point)

    def _carry_of(self, lanes: Lanes) -> Carry:
        """The structure of the carry of all lanes."""
        return jax.eval_shape(self._functions.init, lanes, (self._key, self._shared))

    def as_tree(self, carry: list[Array]) -> Carry:
        """The carry of the experiment from its leaves; traces `init`."""
        return jax.tree.unflatten(jax.tree.structure(self._carry_of(self._no_lanes())), carry)

    def _run(self, name: str, *inputs: PyTree) -> Any:
        """Run a program on the leaves of its inputs."""
        return self._programs[name](*jax.tree.leaves(inputs))

    def place(self, positions: np.ndarray, runs: np.ndarray) -> Lanes:
        """Put the inputs of all lanes on the device: of each, its point in the group and index of its run."""
        lanes = (runs.astype(np.int32), self._group.swept_at(positions))
        return Lanes(*jax.device_put(lanes, self._sharding))

    def init(self, lanes: Lanes) -> Leaves:
        """The carry of every lane before its first advance."""
        return self.fill(self._run("empty"), lanes, np.ones(self.num_lanes, dtype=bool))

    def fill(self, carry: Leaves, lanes: Lanes, is_new: np.ndarray) -> Leaves:
        """Start the runs of some lanes; the buffers of the given carry are donated."""
        is_new = jax.device_put(is_new, self._sharding)
        return self._run("fill", self._key, carry, lanes, is_new, self._shared)

    def advance(self, carry: Leaves, lanes: Lanes) -> tuple[Leaves, dict[str, dict[str, Array]], Status]:
        """Advance every lane once; the buffers of the given carry are donated."""
        carry, tables, status = self._run("advance", carry, lanes, self._shared)
        return carry, tables, Status(*status)

    def recorded(self, tables: Mapping[str, dict[str, Array]], lanes: np.ndarray) -> dict[str, Any]:
        """The tables `[lanes, rows]` of an advance, where those of recorded runs keep the given lanes only.

        These lanes come first; further ones pad the columns to one length, so that one program serves any
        number of lanes.
        """
        of_runs = {name: columns for name, columns in tables.items() if name in self._recorded_tables}
        if not len(lanes):
            kept = jax.tree.map(lambda column: np.empty((0, *column.shape[1:]), column.dtype), of_runs)
        else:
            select = partial(self._run, "recorded") if "recorded" in self._programs else jax.jit(_recorded)
            padded = np.resize(lanes, self._num_recorded).astype(np.int32)
            kept = select(of_runs, jax.device_put(padded, self._sharding)) if of_runs else {}
        return {**tables, **kept}

    def summary(self, carry: Leaves, lanes: Lanes) -> dict[str, Array]:
        """The summary of every lane."""
        return self._run("summary", carry, lanes, self._shared)

    def snapshot(self, carry: Leaves, lanes: Lanes) -> dict[str, dict[str, Array]]:
        """The snapshot of every lane; empty without snapshots or recorded runs."""
        return self._run("snapshot", carry, lanes, self._shared) if "snapshot" in self._programs else {}

    def exported_state(self, carry: Leaves, lanes: Lanes) -> PyTree:
        """The state of every lane that a saved learner is restored from."""
        return self._functions.exported_state(self.as_tree(carry), lanes, self._shared)

    def select(self, carry: Leaves, lanes: np.ndarray) -> Leaves:
        """The carry of some of the lanes of `wider`."""
        return self._run("select", carry, jax.device_put(lanes.astype(np.int32), self._sharding))


def obtain(
    key: str | None,
    device: Device,
    trace: Callable[[], Traced],
    started: Callable[[], None] = lambda: None,
    *,
    are_remade: bool = False,
) -> tuple[Loaded, bool, float]:
    """Load the programs of a group, or trace, compile and save them.

    Programs without a key are not saved, and are traced when they are compiled. `started` is called when
    tracing starts, one group at a time, or when saved programs are loaded. If they `are_remade`, another
    process may have to make the same programs, see `compile_again`.

    Returns:
        The programs, which take only inputs of exactly these shapes on this device; whether other devices and
        later sweeps can load them; the seconds of loading, or of tracing and compiling.
    """
    start = time.perf_counter()
    if held := program_cache.held_programs(key, device):  # an earlier round of a search
        started()
        return held, True, time.perf_counter() - start
    if (made := executables.load(key, device)) is not None:
        started()
        program_cache.hold(key, device, made)
        return made, True, time.perf_counter() - start
    found, saved = program_cache.load(key), set[str]()
    if found is not None:
        started()
        programs, carry = found
        saved.update(programs)
    else:
        with TRACING:
            started()  # not before: time spent waiting for other groups is not compile time of this one
            start = time.perf_counter()
            programs, carry = trace()
            if key is not None:
                # A process that was killed may have saved some of them; these are not exported again.
                kept = {name: program_cache.load_program(key, name) for name in programs}
                saved.update(name for name, program in kept.items() if program is not None)
                programs = {name: kept[name] or each.export(device) for name, each in programs.items()}
            elif are_remade:
                # XLA makes something else of a program than of its export, which is all another process gets.
                programs = {name: _exported(each, device) for name, each in programs.items()}
    ready, are_written = {}, True
    for name, program in programs.items():
        ready[name], events = program_cache.compiled(key, name, program, device)
        compile_counts[name] += WRITTEN in events or FOUND not in events
        are_written = are_written and WRITTEN in events
        if key is not None and name not in saved and program_cache.save_program(key, name, program):
            saved.add(name)
    # Also without a plan's choices: what `Ahead` compiles belongs to a plan that has no folder yet.
    may_be_remade = are_remade or device.platform != "cpu"
    loaded = Loaded(ready, programs.get, carry, contents_of(ready) if may_be_remade else {})
    program_cache.hold(key, device, loaded)
    are_saved = saved == set(programs)
    # The list of names is written last: a group counts as saved only once all its programs are.
    if key is not None and are_saved and found is None:
        are_saved = program_cache.save(key, list(programs), len(carry))
    if key is not None and are_saved and are_written:
        executables.save(key, device, loaded)
    return loaded, are_saved, time.perf_counter() - start


def _exported(program: Program, device: Device) -> Program:
    """The exported program; as it is if it cannot be exported.

    That is a program that calls this process (NotImplementedError), or a kernel that JAX does not know
    (ValueError). It is compiled as it was traced, and can then not be made again by another process.
    """
    try:
        return program.export(device)
    except (NotImplementedError, ValueError):
        return program


@functools.cache
def _key_data(seed: int) -> UInt[np.ndarray, " words"]:
    """The data of the key of a sweep, on the host.

    A key that is made on the device where JAX makes arrays by default could leave it only once all that runs
    there has ended, so that a thread which prepares programs for another device would wait.
    """
    with on_cpu():
        return np.asarray(jax.random.key_data(jax.random.key(seed)))


def run_key(key: Key[Array, ""], run: Int[Array, ""]) -> Key[Array, ""]:
    """The key of a run, equal at every point of a sweep, so that comparisons are paired by run."""
    return jax.random.fold_in(key, run)


def _init(group: StaticGroup, lane: Lanes, key_and_shared: tuple[Key[Array, ""], PyTree]) -> Carry:
    key, shared = key_and_shared
    experiment = group.experiment(lane.swept, shared)
    carry = experiment.init(run_key(key, lane.runs))
    check_init(experiment, carry)
    return carry


def _fill(init: TracedOnce, key, carry: Carry, lanes: Lanes, is_new, shared: PyTree) -> list[Array]:
    # All lanes are started and most results thrown away: a mask keeps one program for any number of new runs.
    def choose(fresh, old):
        return jnp.where(is_new.reshape(-1, *[1] * (old.ndim - 1)), fresh, old)

    return jax.tree.leaves(jax.tree.map(choose, init(lanes, (key, shared)), carry))


def _in_lanes(function: Callable[[Experiment, Carry], PyTree], group: StaticGroup):
    """Batch a function of an experiment and its carry over the lanes."""

    def of_one_lane(lane: tuple[Carry, PyTree], shared: PyTree) -> PyTree:
        carry, swept = lane
        return function(group.experiment(swept, shared), carry)

    in_lanes = TracedOnce(of_one_lane)
    return lambda carry, lanes, shared: in_lanes((carry, lanes.swept), shared)


def _advance(experiment: Experiment, carry: Carry):
    carry, tables, status = checked_advance(experiment, carry, *experiment.advance(carry))
    return jax.tree.leaves(carry), tables, tuple(status)


def checked_advance(experiment: Experiment, before: Carry, after: Carry, records: Records):
    """Check an advance of one lane; returns its carry, its tables and its status."""
    check_advance(experiment, before, after)
    check_records(experiment, records.tables)
    return after, records.tables, Status(experiment.is_done(after), records.active_steps)


def _summary(experiment: Experiment, carry: Carry) -> dict[str, Array]:
    summary = experiment.summary(carry)
    check_summary(experiment, summary)
    return summary


def _recorded(tables: PyTree, lanes: Int[Array, " recorded"]) -> PyTree:
    return jax.tree.map(lambda column: column[lanes], tables)


def _select(carry: Carry, lanes: Int[Array, " selected"]) -> list[Array]:
    return [leaf[lanes] for leaf in jax.tree.leaves(carry)]


def _empty(structure: PyTree[jax.ShapeDtypeStruct]) -> list[Array]:
    return [jnp.empty_like(leaf) for leaf in jax.tree.leaves(structure)]
