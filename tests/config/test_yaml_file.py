"""Scalars follow YAML 1.2, and duplicate keys are refused."""

import pytest
import yaml

from bojax.config.errors import ConfigError
from bojax.config.yaml_file import MAX_BYTES, dump, parse, read_mapping

VALUES = [
    ("1e-5", 1e-5),
    ("1.5E3", 1500.0),
    (".5", 0.5),
    ("-.inf", float("-inf")),
    ("010", 10),
    ("0x1F", 31),
    ("0o17", 15),
    ("1e3", 1000.0),
    ("true", True),
    *((text, text) for text in "-0x1F 0b1 1_000 0x1p3 yes off y = no 1:30 2019-10-01".split()),
    ("", None),
    ("~", None),
    ("!!float 3", 3.0),
    ("!!str 3", "3"),
    ('!!bool "TRUE"', True),
    ("+.INF", float("inf")),
    (str(-(2**63)), -(2**63)),
    ("[1, a, {b: 2.0}]", [1, "a", {"b": 2.0}]),
    ("{a: &x [1], b: *x}", {"a": [1], "b": [1]}),
    ("a: &x {p: 1, q: 2}\nb: {<<: *x, q: 3}", {"a": {"p": 1, "q": 2}, "b": {"p": 1, "q": 3}}),
]


def test_scalars_and_merges():
    for text, value in VALUES:
        got = parse(text, "x.yaml")
        assert got == value and type(got) is type(value), text


def test_text_is_written_so_that_it_is_read_as_text():
    texts = "1e5 0o17 0x1f 017 1_000 1:30 no y .5 ~ << = # é".split()
    texts += ["", "a: b"]
    value = {"texts": texts, "numbers": [1e-5, 1e22, 15, -0.0, 2**62], "other": [True, None, {}]}
    assert parse(dump(value), "x.yaml") == value
    assert yaml.safe_load(dump(value)) == value, "other programs follow YAML 1.1"


def test_a_file_is_read_again_once_it_changed_and_its_value_is_the_readers_own(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("a: [1]\n")
    read_mapping(path, "x.yaml")["a"].append(2)
    assert read_mapping(path, "x.yaml") == {"a": [1]}
    path.write_text("a: [3]\n")
    assert read_mapping(path, "x.yaml") == {"a": [3]}
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_mapping(path, "x.yaml") == {"a": 1}, "a byte order mark is not part of a key"


REFUSED = [
    ("a: 1\nb: 2\na: 3\n", 'x.yaml:3: duplicate key "a" (first on line 1)'),
    ("p:\n  kind: x\n  kind: y\n", 'x.yaml:3: duplicate key "kind" (first on line 2)'),
    ("a: [1, 2\nb: 3\n", "x.yaml:2: is not YAML: "),
    ("a: b: c\n", "x.yaml:1: is not YAML: mapping values are not allowed here"),
    ("a: !!python/name:os.system x\n", "x.yaml:1: got the tag !!python/name:os.system; allowed: !!null, "),
    ("a: !!timestamp foo\n", "x.yaml:1: got the tag !!timestamp; allowed: "),
    ("a: !!set {b}\n", "x.yaml:1: got the tag !!set; allowed: "),
    ("a: !!seq {b: 1}\n", "x.yaml:1: got the tag !!seq; allowed: "),
    ("a: !mine b\n", "x.yaml:1: got the tag !mine; allowed: "),
    ("a: !!bool maybe\n", 'x.yaml:1: got "maybe"; allowed: a value of type !!bool'),
    ('a: !!float ""\n', 'x.yaml:1: got ""; allowed: a value of type !!float'),
    ("a: !!float 1:30\n", 'x.yaml:1: got "1:30"; allowed: a value of type !!float'),
    (f"a: 1{400 * '0'}\n", 'x.yaml:1: got "1000'),
    (f"a: {2**63}\n", f'x.yaml:1: got "{2**63}"; allowed: an integer between -2^63 and 2^63 - 1'),
    ('a: "\\e[31m"\n', 'x.yaml:1: got "\\u001b[31m"; allowed: text without the character "\\u001b"'),
    ('a: "\\ud800"\n', "x.yaml:1: got "),
    ('"\\a": 1\n', 'x.yaml:1: got the key "\\u0007"; allowed: text without the character "\\u0007"'),
    ("a: 1\n---\nb: 2\n", "x.yaml:2: is not YAML: but found another document"),
    ("? [1, 2]\n: 3\n", "x.yaml:1: got a key that is not text; allowed: a name"),
    ("a: &x [*x]\n", "x.yaml: is nested too deeply"),
    ("<<: 3\n", "x.yaml:1: <<: got 3; allowed: a mapping"),
    ("a: \0\n", "x.yaml: is not YAML: "),
    ("[" * 10_000, "x.yaml: is nested too deeply"),
    ("", "x.yaml: is empty"),
    ("# a comment\n", "x.yaml: is empty"),
    ("[1, 2]\n", "x.yaml: holds a list; allowed: a mapping of settings"),
    ("parking\n", "x.yaml: holds text; allowed: a mapping of settings"),
]


def test_refused(write):
    for text, message in REFUSED:
        path = write("x.yaml", text)
        with pytest.raises(ConfigError) as raised:
            read_mapping(path, "x.yaml")
        assert "\n" not in str(raised.value) and str(raised.value).startswith(message)


@pytest.mark.parametrize("multiply", ["[*{0}, *{0}]", "{{p: *{0}, q: *{0}}}", "{{p: {{<<: *{0}}}, q: *{0}}}"])
def test_aliases_that_multiply(multiply, monkeypatch):
    monkeypatch.setattr("bojax.config.yaml_file.MAX_NODES", 20_000)  # to the real limit, it takes seconds
    names = [f"a{index}" for index in range(60)]
    pairs = zip(names, names[1:], strict=False)
    lines = [f"{new}: &{new} {multiply.format(old)}" for old, new in pairs]
    with pytest.raises(ConfigError, match="x: holds too many values; allowed: at most 20,000, with "):
        parse("\n".join(["a0: &a0 {b: 1}", *lines]), "x")


def test_a_file_that_is_too_large_or_no_text(tmp_path):
    path = tmp_path / "x.yaml"
    large = b"#" * (MAX_BYTES + 1), "has more than 4 MiB; allowed: "
    for content, message in (large, (b"a: \xff\xfe", "is not UTF-8 text")):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=f"x.yaml: {message}"):
            read_mapping(path, "x.yaml")
