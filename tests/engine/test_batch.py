"""A compiled group gives the results of single lanes, on any device, and is compiled once."""

import threading
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine import batch
from bojax.engine.batch import TRACING, Functions, Programs, run_key
from bojax.engine.errors import EngineError
from bojax.engine.groups import static_groups
from tests.compiling import events_of_jax
from tests.toy import Toy, toy

SEED = 5
MODULES = [toy(scale=1.0), toy(scale=2.0)]

pytestmark = pytest.mark.usefixtures("kept_toys")


def compile_toys(num_lanes=8, modules=MODULES, device=0, **options) -> Programs:
    (group,) = static_groups(modules)
    given = {"recorded": num_lanes} | options
    return Programs(Functions(group), jax.devices("cpu")[device], num_lanes, SEED, **given)


def place(program, positions, runs):
    pad = [0] * (program.num_lanes - len(runs))
    return program.place(np.array(positions + pad), np.array(runs + pad))


def run_all(program, lanes):
    carry, tables = program.init(lanes), []
    for _ in range(program.max_advances):
        carry, records, _ = program.advance(carry, lanes)
        tables.append(jax.device_get(records["steps"]))
    return jax.device_get(program.summary(carry, lanes)), tables, carry


def alone(module: Toy, run: int):
    """The lane without the engine."""
    carry = module.init(run_key(jax.random.key(SEED), jnp.asarray(run, jnp.int32)))
    advance = jax.jit(lambda carry: module.advance(carry))
    while not module.is_done(carry):
        carry, _ = advance(carry)
    return module.summary(carry)


@pytest.mark.usefixtures("compiles_anew")
def test_functions_are_traced_once_for_all_numbers_of_lanes(monkeypatch):
    expected, calls = alone(MODULES[1], 3)["return"], Counter()

    def count(name, function):
        def counted(*inputs):
            calls[name] += 1
            return function(*inputs)

        return counted

    for name in ("init", "advance", "summary"):
        monkeypatch.setattr(Toy, name, count(name, getattr(Toy, name)))
    (group,) = static_groups(MODULES)
    functions = Functions(group)
    for num_lanes in (8, 3):
        program = Programs(functions, jax.devices("cpu")[0], num_lanes, SEED, recorded=0)
        summary, _, _ = run_all(program, place(program, [0, 1], [3, 3]))
        np.testing.assert_allclose(summary["return"][1], expected, rtol=1e-12)
        assert calls == {"init": 1, "advance": 1, "summary": 1}


@pytest.mark.bits
def test_run_17_alone_is_run_17_of_200():
    program = compile_toys(200)
    all_runs, _, _ = run_all(program, place(program, [0] * 200, list(range(200))))
    one_run, _, _ = run_all(program, place(program, [0], [17]))
    small, _, _ = run_all(*(lambda p: (p, place(p, [0], [17])))(compile_toys(1)))
    for name, values in all_runs.items():
        assert values[17].tobytes() == one_run[name][0].tobytes()  # equal lanes: equal bits
        np.testing.assert_allclose(values[17], small[name][0], rtol=1e-12)


def moving(carry):
    return carry.step, carry.position


def test_a_finished_lane_is_a_no_op():
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    _, _, carry = run_all(program, lanes)
    before = jax.device_get(jax.tree.map(batch.jnp.copy, moving(program.as_tree(carry))))
    carry, records, status = program.advance(carry, lanes)
    assert not np.asarray(records["steps"]["valid"]).any()
    assert np.asarray(status.is_done).all() and not np.asarray(status.active_steps).any()
    after = jax.device_get(moving(program.as_tree(carry)))
    assert jax.tree.all(jax.tree.map(np.array_equal, before, after))


def test_filling_starts_the_new_runs_and_leaves_the_others_alone():
    program = compile_toys(4)
    lanes = place(program, [0] * 4, [0, 1, 2, 3])
    carry, _, _ = program.advance(program.init(lanes), lanes)
    before = jax.device_get(program.as_tree(carry).position)
    lanes = place(program, [0, 1, 0, 1], [0, 9, 2, 7])
    carry = program.fill(carry, lanes, np.array([False, True, False, True]))
    expected = np.array(program.as_tree(program.init(lanes)).position)
    expected[[0, 2]] = before[[0, 2]]
    np.testing.assert_array_equal(program.as_tree(carry).position, expected)


def test_a_selection_of_lanes_goes_on_in_fewer():
    wide = compile_toys(8)
    narrow = Programs(wide._functions, wide.device, 2, SEED, recorded=6, wider=wide.num_lanes)
    lanes = place(wide, [0, 1] * 4, list(range(8)))
    carry, _, _ = wide.advance(wide.init(lanes), lanes)
    chosen = np.array([6, 1])
    fewer, few = narrow.select(carry, chosen), place(narrow, [0, 1], [6, 1])
    carry, records, _ = wide.advance(carry, lanes)
    fewer, selected, _ = narrow.advance(fewer, few)
    of_all = wide.as_tree(carry).position
    np.testing.assert_allclose(narrow.as_tree(fewer).position, np.asarray(of_all)[chosen], rtol=1e-12)
    np.testing.assert_array_equal(selected["steps"]["valid"], np.asarray(records["steps"]["valid"])[chosen])


@pytest.mark.usefixtures("compiles_anew")
def test_each_program_is_compiled_once():
    before = batch.compile_counts.copy()
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    with events_of_jax() as events:
        for start in (0, 8, 16):
            lanes = place(program, [1] * 8, list(range(start, start + 8)))
            _, _, carry = run_all(program, lanes)
            program.snapshot(carry, lanes)
    assert batch.compile_counts - before == {"empty": 1, "fill": 1, "advance": 1, "summary": 1, "snapshot": 1}
    assert not [name for name in events if "compile" in name]


def test_the_carry_is_donated():
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    carry = program.init(lanes)
    program.advance(carry, lanes)
    assert all(leaf.is_deleted() for leaf in carry)


def test_programs_are_made_without_waiting_for_another_device():
    compile_toys(device=1)  # what JAX itself puts on its default device, it does once
    with jax.transfer_guard_device_to_device("disallow_explicit"):
        programs = compile_toys(device=1)
        run_all(programs, place(programs, [0], [0]))


def test_another_shape_raises():
    program = compile_toys()
    other = compile_toys(3)
    with pytest.raises((TypeError, ValueError)):
        program.init(place(other, [0], [0]))


def changed(method: str, change) -> type[Toy]:
    """A toy one of whose methods returns something else."""
    original = getattr(Toy, method)
    return type(Toy)("Changed", (Toy,), {method: lambda self, given: change(original(self, given))})


def unmarked(advanced):
    del advanced[1].tables["steps"]["valid"]
    return advanced


def test_a_mistake_in_an_experiment_is_one_line():
    good = toy()
    for method, change, message in (
        ("init", lambda walk: [walk, 1.0], r"init: carry\[1\] is a Python number"),
        ("advance", lambda made: ([made[0]], made[1]), "advance: the carry's structure changes"),
        ("advance", unmarked, "table 'steps' has no column 'valid'"),
        ("summary", lambda made: made | {"extra": made["steps"]}, "summary: column 'extra' is not declared"),
        ("summary", lambda made: {"return": made["return"]}, "summary: column 'first_right' is declared"),
        ("summary", lambda made: made | {"return": jnp.zeros(2)}, "summary: 'return' has shape"),
        (
            "summary",
            lambda made: made | {"success": made["return"]},
            "summary: 'success' is float64; `tables` declares bool",
        ),
    ):
        kind = changed(method, change)
        with pytest.raises(EngineError, match=message) as error:
            compile_toys(modules=[kind(good.scale, good.start, good.poison, good.max_length)])
        assert "\n" not in str(error.value) and error.value.exit_code == 1


def test_a_compilation_starts_when_no_other_group_is_traced():
    started, seen = threading.Event(), []
    with TRACING:
        compiling = threading.Thread(target=lambda: seen.append(compile_toys(13, started=started.set)))
        compiling.start()
        assert not started.wait(0.3)
    compiling.join()
    assert started.is_set() and seen[0].num_lanes == 13
