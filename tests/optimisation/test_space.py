"""Spaces: what users may write, and positions that stand for values."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.optimisation.kernel import mixed_matern52
from bojax.optimisation.space import Choice, Range, SpaceError, read_space
from tests.refusals import assert_refused

SPACE = {"rate": (1e-5, 1e5, "log"), "depth": (1, 8), "size": (1, 1000, "log"), "kind": ["a", 2, None]}


def test_a_tuple_is_a_range_and_a_list_are_choices():
    rate, depth, size, kind = read_space(SPACE)
    assert rate == Range("rate", 1e-5, 1e5, is_log=True, is_integer=False)
    assert depth == Range("depth", 1, 8, is_log=False, is_integer=True)
    assert size == Range("size", 1, 1000, is_log=True, is_integer=True)
    assert kind == Choice("kind", ("a", 2, None))
    assert read_space({"x": (0, 1.5)})[0] == Range("x", 0.0, 1.5, is_log=False, is_integer=False)
    assert read_space({"x": (np.int64(0), np.int64(3))})[0] == Range("x", 0, 3, False, True)


def test_a_wrong_space_is_refused_in_one_line():
    wrong = [
        ({}, "space: got {}"),
        ([(0, 1)], "space: got"),
        ({1: (0, 1)}, "the name 1"),
        ({"x": (1, 0)}, "x: got 1 and 0; allowed: low < high"),
        ({"x": (0.0, float("inf"))}, "low < high, both finite"),
        ({"x": (0, 8, "log")}, "x: got 0; allowed: > 0"),
        *(({"x": value}, "a tuple") for value in (("a", "b"), (False, True), 3)),
        ({"x": (1, 8, "lin")}, r"x: got \(1, 8, 'lin'\); allowed: a tuple"),
        ({"x": [1.0, float("nan")]}, "x: got NaN; allowed: choices such as texts"),
        ({"x": ["a"]}, "at least two choices"),
        *(({"x": [*pair]}, "choices that differ") for pair in (("a", "a"), (1, 1.0), (1, True))),
        ({"value": (0.0, 1.0)}, 'space: got the name "value"; allowed: any other'),
        ({"x": (0, 2**53 + 1)}, "allowed: integers below"),
        ({"x": (0.0, 10**400)}, "x: got 0 and inf; allowed: low < high, both finite"),
        ({"x": [[1], [2]]}, "choices such as texts"),
    ]
    assert_refused([(partial(read_space, space), message) for space, message in wrong], SpaceError)


def test_values_of_a_user_are_checked():
    rate, depth, _, kind = read_space(SPACE)
    assert depth.checked(8.0) == 8 and isinstance(depth.checked(8.0), int) and rate.checked(1) == 1.0
    assert kind.checked(2) == 2
    for axis, value in ((rate, 0.0), (rate, "1"), (depth, 2.5), (depth, 9), (depth, True), (kind, 2.0)):
        with pytest.raises(SpaceError, match=f"{axis.key}: got"):
            axis.checked(value)


@pytest.mark.parametrize("scale", [(), ("log",)])
def test_a_narrow_range_has_many_values(scale):
    (axis,) = read_space({"x": (100.0, 100.0001, *scale)})
    positions = np.linspace(*axis.box, 1000)
    assert len({axis.value([position]) for position in positions.tolist()}) > 990


@pytest.mark.parametrize("axis", read_space(SPACE), ids=lambda axis: axis.key)
def test_a_position_stands_for_one_value(axis):
    values = axis.values if isinstance(axis, Choice) else [axis.low, axis.high]
    assert [axis.value(axis.position(value)) for value in values] == list(values)
    random, (low, high) = np.random.default_rng(0), axis.box
    for position in random.uniform(low, high, (200, axis.width)):
        assert axis.checked(axis.value(position.tolist())) == axis.value(position.tolist())


def test_the_kernel_sees_the_values_alone():
    axes = read_space(SPACE)
    kernel = eqx.filter_jit(mixed_matern52(jnp.asarray([0.5, 0.7, 0.9, 1.1]), axes))
    random = np.random.default_rng(1)
    boxes = np.asarray([axis.box for axis in axes for _ in range(axis.width)])
    ends = np.cumsum([axis.width for axis in axes])[:-1]

    def values(unit):
        positions = np.split(boxes[:, 0] + 0.5 * (unit + 1.0) * np.ptp(boxes, axis=1), ends)
        return [axis.value(position.tolist()) for axis, position in zip(axes, positions, strict=True)]

    def coordinates(value):
        """A Matern kernel of these is the reference: numbers in [-1, 1], and unlike choices 2 apart."""
        rate, depth, size, kind = value
        low, high = np.log10(0.5), np.log10(1000.5)
        number = np.log10(rate) / 5.0, (depth - 4.5) / 4.0, 2.0 * (np.log10(size) - low) / (high - low) - 1.0
        return np.asarray([*number, *(2.0**0.5 * (kind == each) for each in ("a", 2, None))])

    scales = np.asarray([0.5, 0.7, 0.9, 1.1, 1.1, 1.1])
    for _ in range(50):
        x, y = random.uniform(-1.0, 1.0, (2, len(boxes)))
        apart = (coordinates(values(x)) - coordinates(values(y))) / scales
        r = 5.0**0.5 * np.linalg.norm(apart)
        expected = (1.0 + r + r * r / 3.0) * np.exp(-r)
        assert float(kernel(jnp.asarray(x), jnp.asarray(y))) == pytest.approx(expected, rel=1e-4, abs=1e-6)
