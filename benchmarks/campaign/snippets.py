"""Odd values as they stand in a YAML file: what replaces a setting in a bad config."""

import random
import re


def listed(text: str) -> tuple[str, ...]:
    """The entries of a text, separated by line breaks or by two spaces or more."""
    return tuple(entry for entry in re.split(r" {2,}|\n", text) if entry)


_BAD = (
    *listed(
        r"""
    !!bool maybe  !!timestamp foo  !!float ''  !!int ''  !!int 12abc  !!null x  !!seq {a: 1}  !!map [a]
    !!set {a, b}  !!omap [a: 1]  !!pairs [a]  !!binary '@'  !!python/object/apply:os.system ['true']
    !!python/name:os.system  !!merge x  !local x  !<tag:yaml.org,2002:python/tuple> [1]  !!str {a: 1}
    .nan  .inf  -.inf  !!float .nan  1e400  "\ud800"  "\x1b[31mred\x1b[0m"  "a\0b"  [1, [2, 3], [4]]
    [[1, 2], [3]]  {}  {a: 1}  {kind: }  {kind: 3}  {kind: [a]}  {kind: {kind: x}}  {kind: no-such}  [.nan]
    [null]  *missing  &a [*a]  &a {a: *a}  no_such_module:Thing  os:system  os:no_such  builtins:eval
    builtins:int  collections:OrderedDict  tests.toy:Toy  '  "  {  [1, 2  @x  `x`  %TAG  - - -  ? a
    a: b: c  |
    """
    ),
    *("9" * 400, "-" + "9" * 5000, "'" + "a" * 100_000 + "'", "[" * 60 + "]" * 60, "[" * 5000 + "]" * 5000),
    *("{a: " * 60 + "1" + "}" * 60, "[" + ", ".join(["0"] * 100_000) + "]", "\t1"),
)
"""No setting takes any of these."""

_UNUSUAL = (
    *listed(
        r"""
    null  ~  true  false  no  yes  0  -0  -0.0  1  -1  0.5  2  3  1e3  1e-3  1e308  -1e308  1e-320
    2147483648  9223372036854775808  1e12  100000000  1_000  0x1F  0o17  010  1:30  2024-01-01  ''  ' '  text
    漢字  nan  inf  +1  .5  []  [[]]  [0]  [1, 2]  [1, 2, 3]  [0, 0, 0, 0]  [1e300, -1e300]  [true]
    ['a']  {kind: rbf}  {kind: random}  random  rbf  value  chain  parking  ../x  /dev/null  '=1'
    '$\unknowncmd$'  '<script>'  'a/b'
    """
    ),
    *("'\u202e abc'", "'" + "n" * 300 + "'"),
)
"""Some settings take some of these."""


def odd(draw: random.Random) -> tuple[str, bool]:
    """A value, and whether no setting takes it."""
    if draw.random() < 0.6:
        return draw.choice(_BAD), True
    return draw.choice(_UNUSUAL), False


def shown(text: str) -> str:
    """A snippet in a few characters."""
    text = text.encode("unicode_escape").decode()
    return text if len(text) <= 50 else f"{text[:40]}... ({len(text)} characters)"
