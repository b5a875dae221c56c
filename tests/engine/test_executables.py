"""Compiled programs are loaded without being lowered, with the same bits; what is damaged is made anew."""

import os
import pickle
import zlib

import jax
import numpy as np
import pytest

from bojax.engine import autotuning, batch, executables
from bojax.engine.autotuning import Choices, contents_of
from bojax.engine.batch import Programs
from bojax.engine.program import Program
from bojax.numerics import disk_cache
from bojax.numerics.disk_cache import EXECUTABLES
from bojax.results.folder import RunFolder
from tests.engine.test_program_cache import (
    DEVICE,
    advanced,
    caching_again_in,
    caching_in,
    files,
    group_of,
    programs_of,
    same_bits,
    spoil,
)
from tests.engine.test_program_cache import compiled as compiled
from tests.tiers import by_tier


@pytest.fixture(autouse=True)
def cache(compiled, tmp_path):
    """The cache into which the programs of a group were saved; the folder of compiled programs in it."""
    with caching_again_in(compiled[1].parent, tmp_path / "copy") as programs:
        yield programs.parent / EXECUTABLES


@pytest.fixture(scope="module")
def expected(compiled):
    """What these programs compute."""
    return advanced(compiled[0])


@pytest.fixture
def loads_only(monkeypatch):
    """Nothing is traced, lowered or compiled."""
    monkeypatch.setattr(Programs, "_trace", lambda *_, **__: pytest.fail("traced"))
    monkeypatch.setattr(Program, "deserialized", lambda *_: pytest.fail("read the traced program"))
    monkeypatch.setattr(Program, "compile", lambda *_, **__: pytest.fail("lowered"))


def key_of(group, lanes: int = 3):
    return Programs.key_of(group, DEVICE, lanes, 0, None)


@pytest.mark.bits
@pytest.mark.usefixtures("loads_only")
def test_programs_are_loaded_without_being_lowered_and_give_the_same_bits(compiled, expected):
    jax.clear_caches()
    made, loaded = compiled[0], programs_of(group_of())
    assert loaded.is_saved
    same_bits(advanced(loaded), expected)
    structures = made.carry_structure, loaded.carry_structure
    assert jax.tree.leaves(structures[0]) == jax.tree.leaves(structures[1])
    lanes = loaded.place(np.zeros(3, int), np.arange(3))
    carry = loaded.init(lanes)
    loaded.advance(carry, lanes)
    assert any(leaf.is_deleted() for leaf in jax.tree.leaves(carry)), "its buffers are donated"


@pytest.mark.bits
def test_another_device_lowers_them_once(cache, expected):
    key, other = key_of(group_of()), jax.devices("cpu")[1]
    for _ in range(2):
        found = programs_of(group_of(), device=other)
        assert all(leaf.sharding.device_set == {other} for leaf in jax.tree.leaves(found.carry_structure))
        same_bits(advanced(found), expected)
        assert [path.name[-2:] for path in files(cache)] == ["-0", "-1"]
    assert executables.load(key, other) is not None
    content = disk_cache.read(f"{key}-0", EXECUTABLES)
    assert content is not None and disk_cache.write(f"{key}-1", content, EXECUTABLES)
    assert executables.load(key, other) is None, "the file of another device"


@pytest.mark.parametrize(
    "damage",
    by_tier(
        ["emptied", "cut off", "flipped", "a pipe", "of another group", "of another version"],
        normal=["flipped"],
    ),
)
def test_a_damaged_file_is_not_used_and_is_replaced_by_a_compilation(cache, expected, damage):
    (entry,) = files(cache)
    if damage == "of another group":
        programs_of(group_of(episodes=3))
        (other,) = set(files(cache)) - {entry}
        entry.write_bytes(other.read_bytes())
    elif damage == "of another version":
        assert disk_cache.write(entry.name, zlib.compress(pickle.dumps({"format": 2})), EXECUTABLES)
    else:
        spoil(entry, damage)
    key = key_of(group_of())
    assert executables.load(key, DEVICE) is None
    same_bits(advanced(programs_of(group_of())), expected)
    for kept in cache.parent.glob("jit_*-cache"):
        kept.unlink()
    jax.clear_caches()
    same_bits(advanced(programs_of(group_of())), expected)  # compiled anew, and saved in its place
    assert executables.load(key, DEVICE) is not None


def test_without_the_traced_programs_a_group_is_traced_and_saved_again(cache):
    # As after a change of code that does not change the programs.
    entry = cache.parent / "programs" / str(key_of(group_of()))
    entry.unlink()
    before = batch.compile_counts.copy()
    assert executables.load(key_of(group_of()), DEVICE) is None
    programs_of(group_of())
    assert not batch.compile_counts - before and entry.exists()  # JAX has kept them


def test_programs_that_jax_has_kept_are_not_written_again(cache, expected):
    # XLA would write them without some of their functions.
    for entry in files(cache):
        entry.unlink()
    jax.clear_caches()
    before = batch.compile_counts.copy()
    for _ in range(2):
        same_bits(advanced(programs_of(group_of())), expected)
        assert not files(cache)
    assert not batch.compile_counts - before


def test_the_hashes_of_a_plan_are_saved_with_the_programs(tmp_path, monkeypatch):
    key = key_of(group_of())
    folders = [RunFolder(tmp_path / name) for name in ("first", "second")]
    with caching_in(tmp_path / "empty"):
        for folder in folders:
            folder.work.mkdir(parents=True)
            plan = Choices(folder.choices)
            Programs(batch.Functions(group_of()), DEVICE, 3, 0, recorded=0, choices=plan)
            monkeypatch.setattr(autotuning, "fingerprint", lambda _: pytest.fail("hashed again"))
        monkeypatch.undo()
        loaded = executables.load(key, DEVICE)
    assert loaded is not None and loaded.contents == contents_of(loaded.programs)
    published = [folder.programs() for folder in folders]
    assert published[0] == published[1]
    assert published[0]["0-3-advance"] == loaded.contents["advance"][:16]
    program = loaded.traced("advance")
    assert program is not None and program.exported is not None


def test_what_is_loaded_is_kept(cache):
    entries = [path for path in files(cache.parent / "programs") if not path.name.startswith("jit_")]
    for path in [*entries, *files(cache)]:
        os.utime(path, times=(1e9, 1e9))
    programs_of(group_of())
    programs_of(group_of(episodes=3))  # which deletes what was not used for long
    assert all(path.exists() for path in entries) and len(files(cache)) == 2
