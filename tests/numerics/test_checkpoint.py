"""A checkpoint restores the same bits, keys and shardings, or fails in one line."""

import errno

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
    return Programs(Functions(group), jax.devices("cpu")[1], 6, 0, recorded=0)


@pytest.fixture
def carry(program):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    carry, _, _ = program.advance(program.init(lanes), lanes)
    return carry


@pytest.fixture
def path(tmp_path):
    return tmp_path / "one.npz"


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


def test_round_trip(path, program, carry):
    checkpoint.save(path, carry)
    check_equal(checkpoint.restore(path, program.carry_structure), carry)


def test_a_restored_carry_goes_on(path, program, carry):
    lanes = program.place(np.arange(6) % 2, np.arange(6))
    checkpoint.save(path, carry)
    restored = checkpoint.restore(path, program.carry_structure)
    expected, _, _ = program.advance(carry, lanes)
    found, _, _ = program.advance(restored, lanes)
    assert list(map(bits, found)) == list(map(bits, expected))


def test_trees_of_all_sorts(path):
    tree = {
        "none": jnp.zeros((0, 3)),
        "keys": jax.random.split(jax.random.key(0), 0),
        "other keys": jax.random.split(jax.random.key(1, impl="rbg"), 2),
        "file": [jnp.asarray(True), (jnp.arange(2), None)],
        "half": jnp.linspace(0.0, 1.0, 5, dtype=jnp.bfloat16),
    }
    checkpoint.save(path, tree)
    check_equal(checkpoint.restore(path, structure_of(tree)), tree)
    with np.load(path) as file:
        np.testing.assert_array_equal(file["state['file'][1][0]"], [0, 1])


def test_a_bare_array(path):
    checkpoint.save(path, jnp.arange(3.0))
    check_equal(checkpoint.restore(path, structure_of(jnp.arange(3.0))), jnp.arange(3.0))


@pytest.mark.parametrize(
    ("shapes", "dtype", "reason"),
    [
        (((3,), (2, 2)), float, r"state\[1\] has shape \(2, 3\), not \(2, 2\)"),
        (((3,), (2, 3)), int, r"state\[0\] has dtype float64, not int64"),
        (((3,),), float, "its arrays are not those of this program"),
    ],
)
def test_another_structure_is_refused_in_a_line(path, shapes, dtype, reason):
    checkpoint.save(path, [jnp.zeros(3), jnp.zeros((2, 3))])
    structure = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    with pytest.raises(ResultsError, match=f"{reason}.*: choose another") as error:
        checkpoint.restore(path, structure, advice="choose another")
    assert "\n" not in str(error.value)


def test_missing(path, program):
    with pytest.raises(ResultsError, match="cannot be read") as error:
        checkpoint.restore(path, program.carry_structure)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_refused(path, program, carry, part):
    checkpoint.save(path, carry)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(ResultsError, match="cannot be read") as error:
        checkpoint.restore(path, program.carry_structure)
    assert "\n" not in str(error.value)


def test_no_flipped_bit_changes_a_number(path):
    tree = [jnp.arange(20.0), jnp.arange(5)]
    checkpoint.save(path, tree)
    whole, refused = path.read_bytes(), 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        try:
            check_equal(checkpoint.restore(path, structure_of(tree)), tree)  # a date, for instance
        except ResultsError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > len(whole) / 2


def test_a_failed_write_is_one_error(path, monkeypatch, capfd):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(ResultsError, match="the disk is full") as raised:
        checkpoint.save(path, jnp.arange(3.0))
    assert raised.value.exit_code == 1 and capfd.readouterr().err == ""
    assert not list(path.parent.iterdir())
