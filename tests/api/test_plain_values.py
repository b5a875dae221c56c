"""What a caller gives becomes the values of a YAML file, or is refused in one line."""

from functools import partial

import jax.numpy as jnp
import numpy as np

from bojax.api.plain_values import PlainValues
from bojax.config.errors import ConfigError
from bojax.planning.settings import SBO
from tests.refusals import assert_refused


class Mine:
    class Inner:
        pass


CIRCLE: dict = {}
CIRCLE["a"] = CIRCLE


def test_numbers_arrays_settings_and_classes_have_a_form():
    values = PlainValues()
    text = {"e": {"text": "β: 'x'\n😀", "flag": True}}
    given = {"a": np.float64(1e-7), "b": np.arange(3), "c": jnp.float32(0.5), "d": (1, (2.0, None)), **text}
    plain = {"a": 1e-7, "b": [0, 1, 2], "c": 0.5, "d": [1, [2.0, None]], **text}
    assert values.mapping(given, "config.yaml") == plain
    assert not values.has_classes
    found = values.mapping({"planner": SBO(depth=2), "problem": {"kind": Mine}}, "config.yaml")
    assert found["planner"]["kind"] == "sbo" and found["planner"]["depth"] == 2
    assert found["problem"]["kind"] == "tests.api.test_plain_values:Mine"
    assert values.has_classes


REFUSED = [
    ({"a": {"b": object()}}, "config.yaml: a.b: got <object"),
    ({"a": [1, {2}]}, "config.yaml: a.1: got .2., of type set; allowed: numbers"),
    ({1: 2}, "config.yaml: got the key 1; allowed: text"),
    ({"a": {"b": float("inf")}}, "config.yaml: a.b: got inf; allowed: a finite number"),
    (CIRCLE, "config.yaml: is nested too deeply, or contains itself"),
    ({"a": Mine.Inner}, "config.yaml: a: got the class Mine.Inner; allowed: a class .* top level"),
    ({"a": 2**70}, "config.yaml:1: got .*; allowed: an integer between"),
    ({"a": "\ud800"}, "config.yaml: is not UTF-8"),
    ({"a": "\x00"}, "config.yaml:1: got .*; allowed: text without the character"),
]


def test_anything_else_is_refused():
    read = partial(PlainValues().mapping, name="config.yaml")
    assert_refused([(partial(read, given), message) for given, message in REFUSED], ConfigError)
