"""Programs come back from the cache untraced, with the same bits; what may change unseen is not cached."""

import contextlib
import hashlib
import os
import pickle
import resource
import shutil
import subprocess
import sys
import threading
import time

import equinox as eqx
import jax
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from bojax.config.sweep import load_config, load_sweep
from bojax.engine import batch, devices, program, program_cache
from bojax.engine.batch import Functions, Programs
from bojax.engine.build import build
from bojax.engine.chunks import SHORTEST_ON_CPU
from bojax.engine.groups import static_groups
from bojax.engine.program import GAINS_FROM_GRAPHS, GAINS_FROM_PASSES, Program
from bojax.engine.runner import ChunkRunner
from bojax.envs.robots.base import RobotTask
from bojax.numerics import disk_cache
from bojax.numerics.disk_cache import EXECUTABLES
from tests.engine.drive import run_sweep
from tests.tiers import by_tier
from tests.toy import toy

DEVICE = jax.devices("cpu")[0]


@contextlib.contextmanager
def caching_in(folder):
    """Keep programs in a folder, beside those of JAX."""
    flags = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"
    before = [getattr(jax.config, flag) for flag in flags]
    for flag, value in zip(flags, (str(folder), 0.0), strict=True):
        jax.config.update(flag, value)
    compilation_cache.reset_cache()
    try:
        yield folder / "programs"
    finally:
        for flag, value in zip(flags, before, strict=True):
            jax.config.update(flag, value)
        compilation_cache.reset_cache()


@pytest.fixture(autouse=True)
def cache(tmp_path):
    """An empty cache, beside an empty one of JAX."""
    with caching_in(tmp_path / "cache") as programs:
        yield programs


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The programs of a group, and the cache into which they were saved."""
    with caching_in(tmp_path_factory.mktemp("compiled") / "cache") as folder:
        return programs_of(group_of()), folder


@contextlib.contextmanager
def caching_again_in(folder, copy):
    """Keep programs in the folder that they were saved into, whose place JAX's keys contain, for a while."""
    shutil.copytree(folder, copy)
    with caching_in(folder) as programs:
        yield programs
    shutil.rmtree(folder)
    shutil.copytree(copy, folder)


@pytest.fixture
def entries(compiled, tmp_path):
    """The entries of these programs, the group's own first; no `executables`, with which none is read."""
    with caching_again_in(compiled[1].parent, tmp_path / "copy") as programs:
        shutil.rmtree(programs.parent / EXECUTABLES)
        yield [*groups_in(programs), *programs_in(programs)]


def group_of(**changes):
    overrides = [f"{name}={value}" for name, value in {"episodes": 2, **changes}.items()]
    (point,) = load_config("chain", overrides, None, None).points
    (group,) = static_groups([build(point.config, "float64")])
    return group


def programs_of(group, lanes: int = 3, device=DEVICE) -> Programs:
    return Programs(Functions(group), device, lanes, 0, recorded=0)


def advanced(programs: Programs):
    lanes = programs.place(np.zeros(3, int), np.arange(3))
    carry, records, status = programs.advance(programs.init(lanes), lanes)
    return jax.device_get((programs.summary(carry, lanes), records, status))


def same_bits(first, second):
    assert jax.tree.structure(first) == jax.tree.structure(second)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def files(folder):
    return sorted(folder.iterdir()) if folder.exists() else []


def groups_in(folder):
    """The entries of groups, all of whose programs are saved."""
    return [path for path in files(folder) if "-" not in path.name]


def programs_in(folder):
    """The entries of programs."""
    return [path for path in files(folder) if "-" in path.name and not path.name.startswith("jit_")]


def empty(folder):
    for path in files(folder):
        path.unlink()


@pytest.mark.bits
@pytest.mark.parametrize("device", jax.devices("cpu"), ids=str)
@pytest.mark.usefixtures("entries")
def test_loaded_programs_are_neither_traced_nor_compiled_and_give_the_same_bits(
    compiled, monkeypatch, device
):
    compiled, _ = compiled
    count = batch.compile_counts.total()
    monkeypatch.setattr(Programs, "_trace", lambda *_, **__: pytest.fail("traced"))
    loaded = programs_of(group_of(), device=device)
    if device == DEVICE:  # JAX's cache has an entry for each device of a CPU
        assert batch.compile_counts.total() == count
    assert jax.tree.structure(loaded.carry_structure) == jax.tree.structure(compiled.carry_structure)
    structures = loaded.carry_structure, compiled.carry_structure
    for leaf, other in zip(*map(jax.tree.leaves, structures), strict=True):
        assert (leaf.shape, leaf.dtype) == (other.shape, other.dtype)
        assert leaf.sharding.device_set == {device}
    same_bits(advanced(compiled), advanced(loaded))


def spoil(path, how):
    """Change the bytes in the middle of a file, or put something else in its place."""
    whole = path.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    path.unlink()
    if how in ("a pipe", "a folder"):
        {"a pipe": os.mkfifo, "a folder": os.mkdir}[how](path)
    else:
        path.write_bytes({"emptied": b"", "cut off": whole[:middle], "flipped": flipped}[how])


@pytest.mark.parametrize(
    "damage",
    by_tier(["cut off", "flipped", "a pipe", "without a hash", "a folder"], normal=["flipped", "a folder"]),
)
def test_a_damaged_entry_of_jax_is_compiled_anew_and_replaced(cache, damage):
    # A full disk, or a kill at the wrong moment: JAX never replaces an entry, and verifies no hash.
    expected = advanced(programs_of(group_of()))
    (entry,) = cache.parent.glob("jit_advance_*-cache")
    middle = entry.stat().st_size // 2
    if damage == "without a hash":
        (cache / entry.name).unlink()
    else:
        spoil(entry, damage)
    shutil.rmtree(cache.parent / EXECUTABLES)
    jax.clear_caches()
    before = batch.compile_counts.copy()
    found = advanced(programs_of(group_of()))
    assert batch.compile_counts - before == {"advance": 1}
    jax.tree.map(np.testing.assert_array_equal, found, expected)
    if damage == "a folder":  # nothing is deleted that is no entry
        return
    assert entry.is_file() and entry.stat().st_size > middle
    before = batch.compile_counts.copy()
    programs_of(group_of())
    assert not batch.compile_counts - before


def test_a_full_disk_leaves_no_part_of_an_entry(cache):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))  # bytes of a file, of which some are written
    try:
        assert not program_cache.save("key", [], 0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(cache.iterdir())


def test_programs_that_are_held_are_neither_traced_nor_read(cache, monkeypatch):
    with program_cache.held():
        expected = advanced(programs_of(group_of()))
        empty(cache)
        with monkeypatch.context() as patched:
            patched.setattr(Programs, "_trace", lambda *_, **__: pytest.fail("traced"))
            found = advanced(programs_of(group_of(**{"learner.discount": 0.5})))
            assert not jax.tree.all(jax.tree.map(np.array_equal, found[1], expected[1]))
            found = advanced(programs_of(group_of()))
        jax.tree.map(np.testing.assert_array_equal, found, expected)
    assert program_cache.held_programs(program_cache.key_of(group_of(), DEVICE, 3), DEVICE) is None


def test_only_the_last_programs_are_held(cache):
    held = [program_cache.Loaded({}, {}.get, [jax.ShapeDtypeStruct((number,), bool)]) for number in range(20)]
    with program_cache.held():
        for number, programs in enumerate(held):
            program_cache.hold(str(number), DEVICE, programs)
        assert program_cache.held_programs("3", DEVICE) is None
        assert [program_cache.held_programs(str(number), DEVICE) for number in range(4, 20)] == held[4:]
    assert program_cache.held_programs("19", DEVICE) is None and not files(cache)


def test_a_kill_between_two_programs_costs_those_that_were_not_compiled(cache, monkeypatch, compiled):
    expected = advanced(compiled[0])
    save, kept = program_cache.save_program, []

    def killed(key, name, program):
        if kept:
            raise KeyboardInterrupt
        kept.append(name)
        return save(key, name, program)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(program_cache, "save_program", killed)
        programs_of(group_of())
    (unsaved,) = (path for path in cache.parent.glob("jit_*-cache") if "summary" in path.name)
    unsaved.unlink()  # the kill came before JAX kept it
    jax.clear_caches()
    assert kept == ["advance"] and len(programs_in(cache)) == 1 and not groups_in(cache)
    before = batch.compile_counts.copy()
    found = programs_of(group_of())
    assert "advance" not in batch.compile_counts - before and found.is_saved
    assert len(groups_in(cache)) == 1
    jax.tree.map(np.testing.assert_array_equal, advanced(found), expected)


IN_ANOTHER_PROCESS = """
import sys
import jax
import numpy as np
from bojax.engine import program_cache

jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
(programs, carry), device = program_cache.load("key"), jax.devices("cpu")[0]
factor, _ = program_cache.compiled("key", "factor", programs["factor"], device)
print(carry[0].shape, *factor(np.asarray([[4, 2], [2, 5]], np.float32)).tolist())
"""


def test_a_factorisation_is_loaded_by_a_process_that_has_traced_none(cache):
    matrix = jax.ShapeDtypeStruct((2, 2), np.float32)
    program = Program.of_trees(jax.numpy.linalg.cholesky, matrix).export(DEVICE)
    program_cache.compiled("key", "factor", program, DEVICE)
    assert program_cache.save_program("key", "factor", program) and program_cache.save("key", ["factor"], 1)
    command = [sys.executable, "-c", IN_ANOTHER_PROCESS, str(cache.parent)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "(2, 2) [2.0, 0.0] [1.0, 2.0]\n")


def test_another_number_takes_the_same_programs(cache):
    key = program_cache.key_of(group_of(), DEVICE, 3)
    assert key is not None and program_cache.key_of(group_of(seed=1), DEVICE, 3) == key
    assert program_cache.key_of(group_of(**{"learner.discount": 0.5}), DEVICE, 3) == key


def test_everything_else_takes_others(cache, monkeypatch):
    group = group_of()
    keys = [program_cache.key_of(group, DEVICE, 3, True)]
    keys += [program_cache.key_of(group, DEVICE, 4, True), program_cache.key_of(group, DEVICE, 3, False)]
    keys += [program_cache.key_of(group_of(episodes=3), DEVICE, 3, True)]
    keys += [program_cache.key_of(group_of(**{"env.max_length": 30}), DEVICE, 3, True)]
    with jax.debug_nans(True):
        keys += [program_cache.key_of(group, DEVICE, 3, True)]
    for name, value in {"code_hashes": {"bojax": "changed"}, "installed": {"jax": "9"}}.items():
        with monkeypatch.context() as patch:
            patch.setattr(program_cache, name, lambda _, value=value: value)
            program_cache._environment.cache_clear()
            keys += [program_cache.key_of(group, DEVICE, 3, True)]
    program_cache._environment.cache_clear()
    assert None not in keys and len(set(keys)) == len(keys) == 8


@pytest.mark.parametrize("part", [lambda x: x, toy, toy(), time])
def test_nothing_foreign_may_be_part_of_a_group(cache, part):
    assert program_cache.key_of(group_of(), DEVICE, np.tanh, eqx.nn.Linear) is not None
    assert program_cache.key_of(group_of(), DEVICE, part) is None


@pytest.mark.parametrize(
    "damage",
    by_tier(
        ["emptied", "cut off", "flipped", "renamed", "a pipe", "a pickle"],
        normal=["cut off", "renamed", "a pickle"],
    ),
)
def test_a_damaged_entry_is_not_used_and_replaced(compiled, entries, damage):
    expected = advanced(compiled[0])
    _, entry, other, *_ = entries
    if damage == "renamed":  # a right checksum, and the content of another program
        shutil.copy(other, entry)
    elif damage == "a pickle":
        entry.write_bytes(hashlib.sha256(pickle.dumps(Planted())).digest() + pickle.dumps(Planted()))
    else:
        spoil(entry, damage)
    found = advanced(programs_of(group_of()))
    jax.tree.map(np.testing.assert_array_equal, found, expected)
    key, _, name = entry.name.partition("-")
    assert program_cache.load_program(key, name) is not None


@pytest.mark.parametrize("content", [b"\x80\x04", b"5", b"[[], 0]", b'[["no-such"], 1]'])
def test_an_index_with_other_content_is_not_used_and_replaced(compiled, entries, content):
    group = entries[0].name
    assert disk_cache.write(group, content)  # with a right checksum
    assert program_cache.load(group) is None
    jax.tree.map(np.testing.assert_array_equal, advanced(programs_of(group_of())), advanced(compiled[0]))
    assert program_cache.load(group) is not None


def test_an_entry_that_cannot_be_replaced_leaves_nothing_behind(cache):
    (cache / "key").mkdir(parents=True)
    assert not program_cache.save("key", [], 0)
    assert files(cache) == [cache / "key"]


class Planted:
    """A pickle that would fail the test when it is loaded."""

    def __reduce__(self):
        return pytest.fail, ("a file has run code",)


def test_a_folder_that_is_not_private_is_not_used(tmp_path, monkeypatch):
    assert devices.why_not_private(folder := tmp_path / "own") is None
    assert folder.stat().st_mode & 0o777 == 0o700
    for mode, reason in ((0o777, "others can write to it"), (0o702, "others can write to it"), (0o755, None)):
        folder.chmod(mode)
        assert devices.why_not_private(folder) == reason
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert devices.why_not_private(folder) == "it belongs to another user"


def test_pipes_and_links_among_the_entries_of_jax_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setenv("BOJAX_CACHE", str(tmp_path))
    tmp_path.chmod(0o700)
    os.mkfifo(tmp_path / "jit_add-1-cache")
    (tmp_path / "jit_sub-1-cache").symlink_to("/dev/zero")
    (tmp_path / "jit_mul-1-cache").write_bytes(b"whole")
    jax.config.update("jax_compilation_cache_dir", None)
    devices.prepare("cpu")
    assert [path.name for path in tmp_path.glob("*-cache")] == ["jit_mul-1-cache"]


def test_without_a_private_folder_nothing_is_cached_and_a_line_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BOJAX_CACHE", str(tmp_path))
    tmp_path.chmod(0o777)
    jax.config.update("jax_compilation_cache_dir", None)
    devices.prepare("cpu")
    assert jax.config.jax_compilation_cache_dir is None
    assert capsys.readouterr().err == f"note: programs are not cached in {tmp_path}: others can write to it\n"


def test_entries_that_are_not_used_are_deleted(cache):
    cache.mkdir(parents=True)
    for name, days in (("old", 40), ("new", 3)):
        (cache / name).write_bytes(b"")
        os.utime(cache / name, times=(time.time() - days * 86400,) * 2)
    assert program_cache.save("key", [], 0)
    assert [path.name for path in files(cache)] == ["key", "new"]


@pytest.mark.parametrize("folder", [None, "gs://bucket/cache"])
def test_without_a_folder_nothing_is_cached(folder, here):
    jax.config.update("jax_compilation_cache_dir", folder)
    group = group_of()
    assert program_cache.key_of(group, DEVICE, 3) is None
    assert program_cache.load(None) is None and not list(here.iterdir())


def test_a_folder_that_cannot_be_written_costs_nothing_else(cache):
    cache.parent.mkdir()
    cache.write_text("a file")
    assert advanced(programs_of(group_of()))[0]["success"].shape == (3,)


@pytest.mark.parametrize("name", ["parking", "fig-5.2a", "table-5.3-mountain-car"])
def test_groups_of_shipped_sweeps_are_cached(cache, name):
    sweep = load_sweep(name)
    modules = [build(point.config, getattr(point.config, "dtype", "float64")) for point in sweep.points]
    assert None not in [program_cache.key_of(group, DEVICE, 3) for group in static_groups(modules)]


@pytest.mark.parametrize("calls_process", [False, True])
def test_programs_that_call_this_process_are_not_cached(cache, monkeypatch, calls_process):
    monkeypatch.setattr(RobotTask, "calls_process", calls_process)
    (point,) = load_config("hopper", [], None, None).points
    (group,) = static_groups([build(point.config, "float32")])
    assert (program_cache.key_of(group, DEVICE, 3) is None) == calls_process


def test_several_devices_trace_a_program_once(cache, monkeypatch, tmp_path):
    # JAX's cache has an entry for each device of a CPU, and one for all GPUs.
    devices = jax.devices("cpu")
    used, advance = set(), ChunkRunner.advance

    def noted(runner):
        used.add(threading.get_ident())
        both.wait()
        advance(runner)

    both = threading.Barrier(len(devices), timeout=60.0)  # each device takes a chunk
    monkeypatch.setattr(ChunkRunner, "advance", noted)
    exported, export = [], Program.export
    monkeypatch.setattr(Program, "export", lambda *given: [exported.append(given), export(*given)][1])
    sweep = load_config("chain", ["episodes=2", "engine.device=cpu"], 2 * SHORTEST_ON_CPU, None)
    assert run_sweep(sweep, tmp_path / "chain", devices=[0, 1]) == 0
    assert len(used) == len(devices) == 2
    assert len(exported) == len(programs_in(cache))


def test_a_program_that_is_compiled_twice_keeps_both_entries(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "_has_bare_condition", lambda _: True)
    graphs = {"xla_gpu_enable_command_buffer": "WHILE"}
    monkeypatch.setattr(program, "_options", lambda *_: dict(graphs))
    made = Program.of_trees(lambda x: jax.numpy.sin(x) + 1, np.zeros(3))
    with caching_in(tmp_path):
        key = "0" * 64
        first = [program_cache.compiled(key, "twice", made, DEVICE)[1] for _ in range(2)]
        for entry in list(tmp_path.glob("jit_twice_*-cache"))[:1]:
            entry.unlink()
        again = [program_cache.compiled(key, "twice", made, DEVICE)[1] for _ in range(2)]
    both = {program_cache.FOUND, program_cache.WRITTEN}
    found = [sorted(events & both) for events in (*first, *again)]
    assert found == [[program_cache.WRITTEN], [program_cache.FOUND], sorted(both), [program_cache.FOUND]]


@pytest.mark.parametrize(
    "config, overrides, gains",
    [
        ("vdp-tag", ["planner=pft-dpw", "planner.proposal=gp"], {GAINS_FROM_PASSES, GAINS_FROM_GRAPHS}),
        ("vdp-tag", ["planner=pft-dpw", "planner.proposal=random"], {GAINS_FROM_GRAPHS}),
        ("chain", [], set()),
    ],
)
def test_the_engine_knows_what_makes_the_advances_of_a_search_on_beliefs_faster(
    monkeypatch, config, overrides, gains
):
    (point,) = load_config(config, overrides, None, None).points
    (group,) = static_groups([build(point.config, "float64")])
    monkeypatch.setattr(batch, "obtain", lambda key, device, trace, *_, **__: traced(trace()[0]))

    def traced(programs):
        raise StopIteration(programs)

    with pytest.raises(StopIteration) as stopped:
        programs_of(group)
    programs = stopped.value.value
    assert {name: set(each.gains) for name, each in programs.items() if each.gains} == (
        {"advance": gains} if gains else {}
    )


def test_only_rows_of_recorded_lanes_leave_the_device():
    programs = Programs(Functions(group_of()), DEVICE, 3, 0, recorded=2)
    given = programs.place(np.zeros(3, int), np.arange(3))
    _, tables, _ = programs.advance(programs.init(given), given)
    for lanes in ([], [1], [0, 2]):
        kept = programs.recorded(tables, np.asarray(lanes, dtype=int))
        assert kept["episodes"] is tables["episodes"]
        for name, column in kept["steps"].items():
            assert len(column) == (2 if lanes else 0)
            np.testing.assert_array_equal(column[: len(lanes)], np.asarray(tables["steps"][name])[lanes])
