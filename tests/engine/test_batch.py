"""A compiled group gives the results of single lanes, on any number of CPU devices, and is compiled once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine import batch
from bojax.engine.batch import Compiled, run_key
from bojax.engine.devices import make_mesh
from bojax.engine.errors import EngineError
from bojax.engine.groups import static_groups
from tests.toy import Toy, toy

SEED = 5
MODULES = [toy(scale=1.0), toy(scale=2.0)]


def compile_toys(num_devices=2, lanes_per_device=4, modules=MODULES) -> Compiled:
    (group,) = static_groups(modules)
    return Compiled(
        group, make_mesh(jax.devices("cpu")[:num_devices]), lanes_per_device, SEED, snapshots=True
    )


def place(program, positions, runs):
    pad = program.num_lanes - len(runs)
    return program.place(
        np.array(positions + [0] * pad), np.array(runs + [0] * pad), np.arange(program.num_lanes) < len(runs)
    )


def run_all(program, lanes):
    carry, tables = program.init(lanes), []
    for _ in range(program.max_advances):
        carry, records, _ = program.advance(carry, lanes)
        tables.append(jax.device_get(records["steps"]))
    return jax.device_get(program.summary(carry, lanes)), tables, carry


def alone(module: Toy, run: int):
    """The lane without the engine."""
    carry = module.init(run_key(jax.random.key(SEED), jnp.asarray(run, jnp.int32)))
    while not module.is_done(carry):
        carry, _ = module.advance(carry)
    return module.summary(carry)


def test_lanes_are_what_single_runs_are():
    program = compile_toys()
    positions, runs = [0, 1, 1, 0, 1], [0, 0, 3, 17, 17]
    summary, _, _ = run_all(program, place(program, positions, runs))
    assert len(set(summary["return"][:5].tolist())) == 5
    for lane, (position, run) in enumerate(zip(positions, runs, strict=True)):
        expected = alone(MODULES[position], run)
        for name, value in expected.items():
            np.testing.assert_allclose(summary[name][lane], value, rtol=1e-12)


def test_points_share_run_keys():
    program = compile_toys()
    summary, _, _ = run_all(program, place(program, [0, 1], [4, 4]))
    assert summary["steps"][0] == summary["steps"][1]


@pytest.mark.bits
def test_run_17_alone_is_run_17_of_200():
    program = compile_toys(lanes_per_device=100)
    all_runs, _, _ = run_all(program, place(program, [0] * 200, list(range(200))))
    one_run, _, _ = run_all(program, place(program, [0], [17]))
    small, _, _ = run_all(*(lambda p: (p, place(p, [0], [17])))(compile_toys(1, 1)))
    for name, values in all_runs.items():
        assert values[17].tobytes() == one_run[name][0].tobytes()  # equal lanes per device: equal bits
        np.testing.assert_allclose(values[17], small[name][0], rtol=1e-12)


@pytest.mark.bits
def test_two_devices_give_what_one_gives():
    runs = list(range(8))
    two = compile_toys(num_devices=2, lanes_per_device=4)
    one = compile_toys(num_devices=1, lanes_per_device=4)
    both, _, _ = run_all(two, place(two, [1] * 8, runs))
    first, _, _ = run_all(one, place(one, [1] * 4, runs[:4]))
    second, _, _ = run_all(one, place(one, [1] * 4, runs[4:]))
    for name, values in both.items():
        assert values.tobytes() == np.concatenate([first[name], second[name]]).tobytes()


def test_a_finished_lane_is_a_no_op():
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    _, _, carry = run_all(program, lanes)
    before = jax.device_get(jax.tree.map(batch.jnp.copy, (carry.step, carry.position)))
    carry, records, status = program.advance(carry, lanes)
    assert not np.asarray(records["steps"]["valid"]).any()
    assert np.asarray(status.remaining).sum() == 0 and np.asarray(status.active_steps).sum() == 0
    after = jax.device_get((carry.step, carry.position))
    assert jax.tree.all(jax.tree.map(np.array_equal, before, after))


def test_padding_leaves_no_trace():
    program = compile_toys()
    lanes = place(program, [0, 0, 0], [0, 1, 2])
    carry = program.init(lanes)
    carry, records, status = program.advance(carry, lanes)
    assert not np.asarray(records["steps"]["valid"])[3:].any()
    assert np.asarray(status.remaining).sum() <= 3
    assert np.asarray(status.active_steps).sum() == np.asarray(carry.step)[:3].sum()


def test_each_program_is_compiled_once():
    before = batch.compile_counts.copy()
    events = []
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    jax.monitoring.register_event_duration_secs_listener(lambda name, _, **__: events.append(name))
    try:
        for start in (0, 8, 16):
            lanes = place(program, [1] * 8, list(range(start, start + 8)))
            _, _, carry = run_all(program, lanes)
            program.snapshot(carry, lanes)
    finally:
        jax.monitoring.clear_event_listeners()
    assert batch.compile_counts - before == {"init": 1, "advance": 1, "summary": 1, "snapshot": 1}
    assert not [name for name in events if "compile" in name]


def test_the_carry_is_donated():
    program = compile_toys()
    lanes = place(program, [0] * 8, list(range(8)))
    carry = program.init(lanes)
    program.advance(carry, lanes)
    assert carry.position.is_deleted()


def test_another_shape_raises():
    program = compile_toys()
    other = compile_toys(lanes_per_device=3)
    with pytest.raises((TypeError, ValueError)):
        program.init(place(other, [0], [0]))


class Weak(Toy):
    def init(self, key):
        walk = super().init(key)
        return [walk, 1.0]


class Drifting(Toy):
    def advance(self, carry):
        carry, records = super().advance(carry)
        return [carry], records


class Undeclared(Toy):
    def summary(self, carry):
        return {**super().summary(carry), "extra": carry.step}


class Silent(Toy):
    def summary(self, carry):
        return {"return": carry.position[0]}


class Vectorial(Toy):
    def summary(self, carry):
        return {**super().summary(carry), "return": carry.position}


class Mistyped(Toy):
    def summary(self, carry):
        return {**super().summary(carry), "success": carry.position[0]}


class Unmarked(Toy):
    def advance(self, carry):
        carry, records = super().advance(carry)
        del records.tables["steps"]["valid"]
        return carry, records


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Weak, r"init: carry\[1\] is a Python number"),
        (Drifting, "advance: the carry's structure changes"),
        (Undeclared, "summary: column 'extra' is not declared"),
        (Silent, "summary: column 'first_right' is declared"),
        (Vectorial, "summary: 'return' has shape"),
        (Mistyped, "summary: 'success' is float64; `tables` declares bool"),
        (Unmarked, "table 'steps' has no column 'valid'"),
    ],
)
def test_a_mistake_in_an_experiment_is_one_line(kind, message):
    good = toy()
    with pytest.raises(EngineError, match=message) as error:
        compile_toys(modules=[kind(good.scale, good.start, good.poison, good.max_length)])
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 1
