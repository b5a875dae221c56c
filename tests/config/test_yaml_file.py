"""YAML means what it looks like, and every key stands once."""

import pytest

from bojax.config.errors import ConfigError
from bojax.config.yaml_file import parse, read_mapping


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-5", 1e-5),
        ("1.5E3", 1500.0),
        (".5", 0.5),
        ("-.inf", float("-inf")),
        ("010", 10),
        ("no", "no"),
        ("1:30", "1:30"),
        ("2019-10-01", "2019-10-01"),
        ("true", True),
        ("", None),
        ("~", None),
        ("[1, a, {b: 2.0}]", [1, "a", {"b": 2.0}]),
        ("{a: &x [1], b: *x}", {"a": [1], "b": [1]}),
        ("a: &x {p: 1, q: 2}\nb: {<<: *x, q: 3}", {"a": {"p": 1, "q": 2}, "b": {"p": 1, "q": 3}}),
    ],
)
def test_scalars_and_merges(text, value):
    got = parse(text, "x.yaml")
    assert got == value
    assert type(got) is type(value)


def test_a_byte_order_mark_is_no_key(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_mapping(path, "x.yaml") == {"a": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", 'x.yaml:3: duplicate key "a" (first on line 1)'),
        ("p:\n  kind: x\n  kind: y\n", 'x.yaml:3: duplicate key "kind" (first on line 2)'),
        ("a: [1, 2\nb: 3\n", "x.yaml:2: is not YAML: "),
        ("a: b: c\n", "x.yaml:1: is not YAML: mapping values are not allowed here"),
        ("a: !!python/name:os.system x\n", "x.yaml:1: is not YAML: could not determine a constructor"),
        ("a: 1\n---\nb: 2\n", "x.yaml:2: is not YAML: but found another document"),
        ("? [1, 2]\n: 3\n", "x.yaml:1: a key must be a name"),
        ("a: &x [*x]\n", "x.yaml:1: an alias refers to the value that it stands in"),
        ("<<: 3\n", "x.yaml:1: << takes a mapping"),
        ("a: \0\n", "x.yaml: is not YAML: "),
        ("[" * 10_000, "x.yaml: is nested too deeply"),
        ("", "x.yaml: is empty"),
        ("# a comment\n", "x.yaml: is empty"),
        ("[1, 2]\n", "x.yaml: holds a list; a mapping of settings"),
        ("parking\n", "x.yaml: holds a text; a mapping of settings"),
    ],
)
def test_refused(write, text, message):
    path = write("x.yaml", text)
    with pytest.raises(ConfigError) as raised:
        read_mapping(path, "x.yaml")
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith(message)


def test_a_file_that_is_not_text(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_bytes(b"a: \xff\xfe")
    with pytest.raises(ConfigError, match="x.yaml: is not text in UTF-8"):
        read_mapping(path, "x.yaml")
