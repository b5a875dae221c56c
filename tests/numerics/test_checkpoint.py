"""A checkpoint restores the same bits, keys and shardings, or fails in one line."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.batch import Functions, Programs
from bojax.engine.groups import static_groups
from bojax.numerics import checkpoint
from bojax.results.store import ResultsError
from tests.toy import toy


@pytest.fixture(scope="module")
def program():
    (group,) = static_groups([toy(), toy(scale=2.0)])
    return Programs(Functions(group), jax.devices("cpu")[1], 6, 0, snapshots=False, fills=True)


@pytest.fixture
def carry(program):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    carry, _, _ = program.advance(program.init(lanes), lanes)
    return carry


def bits(leaf):
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    return np.asarray(leaf).tobytes()


def test_round_trip(tmp_path, program, carry):
    checkpoint.save(tmp_path / "one", carry)
    restored = checkpoint.restore(tmp_path / "one", program.carry_structure)
    assert jax.tree.structure(restored) == jax.tree.structure(carry)
    for old, new in zip(jax.tree.leaves(carry), jax.tree.leaves(restored), strict=True):
        assert old.dtype == new.dtype and old.sharding.is_equivalent_to(new.sharding, old.ndim)
        assert bits(old) == bits(new)


def test_a_restored_carry_goes_on(tmp_path, program, carry):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    checkpoint.save(tmp_path / "one", carry)
    restored = checkpoint.restore(tmp_path / "one", program.carry_structure)
    expected, _, _ = program.advance(carry, lanes)
    found, _, _ = program.advance(restored, lanes)
    assert bits(found.position) == bits(expected.position)


def test_an_array_without_a_number_comes_back(tmp_path):
    tree = {"none": jnp.zeros((0, 3)), "keys": jax.random.split(jax.random.key(0), 0), "some": jnp.arange(2)}
    checkpoint.save(tmp_path / "one", tree)
    structure = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=leaf.sharding), tree
    )
    restored = checkpoint.restore(tmp_path / "one", structure)
    assert {name: (leaf.shape, leaf.dtype) for name, leaf in restored.items()} == {
        name: (leaf.shape, leaf.dtype) for name, leaf in tree.items()
    }
    assert bits(restored["some"]) == bits(tree["some"])


@pytest.mark.parametrize("shapes", [((3,), (2, 2)), ((3,),)])
def test_another_structure_is_refused_in_a_line(tmp_path, capfd, shapes):
    checkpoint.save(tmp_path / "one", [jnp.zeros(3), jnp.zeros((2, 3))])
    structure = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]
    with pytest.raises(ResultsError, match="(shape|arrays).*: choose another") as error:
        checkpoint.restore(tmp_path / "one", structure, advice="choose another")
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_missing(tmp_path, program):
    with pytest.raises(ResultsError, match="cannot be read") as error:
        checkpoint.restore(tmp_path / "none", program.carry_structure)
    assert "\n" not in str(error.value)


@pytest.mark.filterwarnings("ignore:coroutine:RuntimeWarning")  # Orbax drops its unfinished reads
def test_every_truncated_file_is_noticed(tmp_path, program, carry):
    checkpoint.save(tmp_path / "one", carry)
    needed = 0
    files = [path for path in (tmp_path / "one").rglob("*") if path.is_file() and path.stat().st_size]
    for path in files:
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        try:
            restored = checkpoint.restore(tmp_path / "one", program.carry_structure)
        except ResultsError as error:
            assert "\n" not in str(error)
            needed += 1
        else:  # a file that the restored carry does not depend on
            assert bits(restored.position) == bits(carry.position)
        path.write_bytes(whole)
    assert needed


def test_a_flipped_bit_of_any_file_is_noticed(tmp_path):
    checkpoint.save(tmp_path / "one", jnp.arange(1000.0))
    structure = jax.ShapeDtypeStruct((1000,), jnp.float64)
    files = [path for path in (tmp_path / "one").rglob("*") if path.is_file() and path.stat().st_size]
    assert len(files) > 3
    for path in files:
        whole = bytearray(path.read_bytes())
        path.write_bytes(bytes([whole[0] ^ 4]) + whole[1:])
        with pytest.raises(ResultsError, match="checkpoint cannot be read") as error:
            checkpoint.restore(tmp_path / "one", structure)
        assert "\n" not in str(error.value)
        path.write_bytes(whole)
    assert checkpoint.restore(tmp_path / "one", structure).tolist() == list(range(1000))


def test_a_failed_write_is_one_error_and_no_log(tmp_path, monkeypatch, capfd):
    from orbax.checkpoint import v1

    def fail(*_, **__):
        logging.getLogger("absl").error("a stack of many lines")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(v1, "save", fail)
    with pytest.raises(ResultsError, match="the disk is full") as raised:
        checkpoint.save(tmp_path / "one", jnp.arange(3.0))
    assert raised.value.exit_code == 1 and capfd.readouterr().err == ""
