"""A checkpoint restores the same bits, keys and shardings, or fails in one line."""

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.batch import Functions, Programs
from bojax.engine.groups import static_groups
from bojax.numerics import checkpoint
from bojax.results.store import ResultsError
from tests.refusals import one_line
from tests.toy import toy


@pytest.fixture(scope="module")
def program():
    (group,) = static_groups([toy(), toy(scale=2.0)])
    return Programs(Functions(group), jax.devices("cpu")[1], 6, 0, recorded=0)


@pytest.fixture
def carry(program):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    carry, _, _ = program.advance(program.init(lanes), lanes)
    return carry


@pytest.fixture
def path(tmp_path):
    return tmp_path / "one"


def save(path, tree):
    checkpoint.save(path, checkpoint.arrays(tree))()


def bits(leaf):
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    return np.asarray(leaf).tobytes()


def structure_of(tree):
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=leaf.sharding), tree
    )


def check_equal(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for new, old in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert (new.shape, new.dtype) == (old.shape, old.dtype)
        assert new.sharding.is_equivalent_to(old.sharding, old.ndim)
        assert bits(new) == bits(old)


def test_a_restored_carry_has_its_bits_and_goes_on(path, program, carry):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    wait = checkpoint.save(path, checkpoint.arrays(carry))
    expected = carry
    for _ in range(3):  # an advance takes over the buffers that are being written
        expected, _, _ = program.advance(expected, lanes)
    wait()
    restored = checkpoint.restore(path, program.carry_structure)
    again, _, _ = program.advance(program.init(lanes), lanes)
    check_equal(restored, again)
    for _ in range(3):
        restored, _, _ = program.advance(restored, lanes)
    check_equal(restored, expected)


def test_trees_of_all_sorts(path):
    tree = {
        "none": jnp.zeros((0, 3)),
        "keys": jax.random.split(jax.random.key(0), 0),
        "other keys": jax.random.split(jax.random.key(1, impl="rbg"), 2),
        "file": [jnp.asarray(True), (jnp.arange(2), None)],
        "half": jnp.linspace(0.0, 1.0, 5, dtype=jnp.bfloat16),
    }
    save(path, tree)
    check_equal(checkpoint.restore(path, structure_of(tree)), tree)
    save(path.with_name("bare"), jnp.arange(3.0))
    check_equal(checkpoint.restore(path.with_name("bare"), structure_of(jnp.arange(3.0))), jnp.arange(3.0))


@pytest.mark.parametrize(
    ("shapes", "dtype", "reason"),
    [
        (((3,), (2, 2)), float, r"1 has shape \(2, 3\), not \(2, 2\)"),
        (((3,), (2, 3)), jnp.float32, "0 has dtype float64, not float32"),
        (((3,),), float, "its arrays are not those of this program"),
    ],
)
def test_another_structure_is_refused_in_a_line(path, shapes, dtype, reason):
    tree = [jnp.zeros(3), jnp.zeros((2, 3))]
    save(path, tree)
    structure = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    for read in (
        lambda: checkpoint.restore(path, structure, advice="choose another"),
        lambda: checkpoint.fit(jax.device_get(checkpoint.arrays(tree)), structure, path, "choose another"),
    ):
        with one_line(ResultsError, f"{reason}.*: choose another"):
            read()


def test_missing(path, program):
    with one_line(ResultsError, "cannot be read"):
        checkpoint.restore(path, program.carry_structure)


def test_threads_save_side_by_side(tmp_path):
    def work(number):
        for again in range(8):
            tree = [jnp.full(50, float(number)), jnp.arange(again + 1)]
            save(tmp_path / f"{number}-{again}", tree)
            check_equal(checkpoint.restore(tmp_path / f"{number}-{again}", structure_of(tree)), tree)

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(work, number) for number in range(4)]:
            done.result()


@pytest.mark.parametrize("code", ["ValueError: [os_error_code='28']", errno.ENOSPC])
def test_a_failed_write_is_one_error(path, monkeypatch, code):
    def fail(folder, _):
        (folder.parent / f"{folder.name}.orbax-checkpoint-tmp").mkdir()
        raise ValueError(code) if isinstance(code, str) else OSError(code, "No space left on device")

    monkeypatch.setattr("orbax.checkpoint.v1.save_async", fail)
    with pytest.raises(ResultsError, match="one: the disk is full") as raised:
        save(path, jnp.arange(3.0))
    assert raised.value.exit_code == 1 and not list(path.parent.iterdir())


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="only Linux can pin the folder above")
@pytest.mark.parametrize("seconds", [0.0, 0.01, 0.03])
def test_a_deleted_working_folder_is_not_made_again(tmp_path, seconds):
    (tmp_path / "work" / "chunk").mkdir(parents=True)
    wait = checkpoint.save(tmp_path / "work" / "chunk" / "one", {str(i): jnp.ones(30_000) for i in range(10)})
    time.sleep(seconds)
    (tmp_path / "work").rename(tmp_path / "done")
    shutil.rmtree(tmp_path / "done", ignore_errors=True)
    with contextlib.suppress(ResultsError):
        wait()
    assert not (tmp_path / "work").exists()
    with pytest.raises(ResultsError, match="cannot be written"):
        save(tmp_path / "work" / "chunk" / "two", jnp.ones(3))
    assert not (tmp_path / "work").exists()


FULL = """
import gc, pathlib, sys
import jax.numpy as jnp
from bojax.numerics import checkpoint
from bojax.results.store import ResultsError
disk = pathlib.Path(sys.argv[1])
for room in (0, 1, 2, 5):
    (disk / "filler").write_bytes(bytes((512 - 1 - room) * 4096))
    try:
        checkpoint.save(disk / "one", {str(i): jnp.ones(3000) for i in range(4)})()
    except ResultsError as error:
        print(error)
    gc.collect()
    assert [path.name for path in disk.iterdir()] == ["filler"]
"""


def test_a_disk_that_is_full_is_one_line_each_time(tmp_path):
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(tmp_path)]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("needs the right to mount a disk")
    try:
        ended = subprocess.run([sys.executable, "-c", FULL, tmp_path], capture_output=True, text=True)
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)
    advice = "free some space, then run the command again, a sweep with --resume"
    full = f"{tmp_path}/one: the disk is full; {advice}"
    assert (ended.stdout.splitlines(), ended.stderr) == ([full] * 4, "")
