"""Configuration errors as one line each: the place, the value found there, the values allowed."""

import difflib
import functools
import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pydantic

from bojax.errors import UserError
from bojax.text import one_line

Location = tuple[int | str, ...]

MAX_SHOWN = 60
"""Maximum length of a quoted value, in characters."""

MAX_NAMES = 10
"""Maximum number of names in a message."""

LIST = "bojax list"
"""The command that lists parts, configs and sweeps."""

MAX_MESSAGE = 400
"""Maximum length of a message, in characters."""

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


_BREAK = re.compile(r"[\t\n\u2028\u2029]")


class ConfigError(UserError, ValueError):
    """A mistake in a configuration."""


def shown(value: Any) -> str:
    """A value as in a YAML file, on one line and cut to `MAX_SHOWN` characters."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = one_line(repr(value))
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


def control_character(text: str, *, allows_breaks: bool = True) -> str | None:
    """The first control character or unpaired surrogate of a text, quoted; None if it has none.

    Tabs and line breaks are allowed, unless `allows_breaks` is false.
    """
    match = _CONTROL.search(text) or (None if allows_breaks else _BREAK.search(text))
    return match and shown(match[0])


def escaped(text: str) -> str:
    """A text on one line, with escape sequences in place of unprintable characters."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in one_line(text)
    )


def printable(message: object) -> str:
    """A message for the terminal: one line, escaped, with the middle of a very long message left out."""
    text, half = escaped(str(message)), MAX_MESSAGE // 2 - 3
    return text if len(text) <= MAX_MESSAGE else f"{text[:half]} ... {text[-half:]}"


def say(message: object) -> None:
    """Print a message on standard error, as `printable` writes it."""
    print(printable(message), file=sys.stderr)


@functools.cache
def note_once(text: str) -> None:
    """Print a line on standard error, once in a process."""
    say(text)


def did_you_mean(name: Any, names: Iterable[str]) -> str:
    """`; did you mean "x"?` with the name nearest to `name`; empty if no name is near.

    A name that continues the given one at a hyphen, as `fig-5.3-taxi` continues `fig-5.3`, is nearest.
    """
    name, names = str(name)[:MAX_SHOWN], sorted(names)
    close = (match for each in (name, name.lower()) for match in difflib.get_close_matches(each, names, n=1))
    near = _continued(name, names) or [*close]
    return f'; did you mean "{near[0]}"?' if near else ""


def allowed_names(name: Any, names: Iterable[str], command: str = "") -> str:
    """The end of a message about an unknown name: `; allowed: a, b, c; did you mean "a"?`, see `listed`."""
    names = sorted(names)
    if not names:
        return "; allowed: none"
    return "; allowed: " + listed(name, names, command) + did_you_mean(name, names)


def listed(name: Any, names: Iterable[str], command: str = "") -> str:
    """Names in alphabetical order; of a long list, those nearest to `name` and the number of the others.

    `command` lists all of them.
    """
    names = sorted(names)
    if len(names) <= MAX_NAMES:
        return ", ".join(names)
    matcher = difflib.SequenceMatcher(b=str(name)[:MAX_SHOWN])

    def distance(other: str) -> float:
        matcher.set_seq1(other)
        return -matcher.ratio()

    near = list(dict.fromkeys([*_continued(str(name), names), *sorted(names, key=distance)]))[:MAX_NAMES]
    all_of_them = f" (see: {command})" if command else ""
    return f"{', '.join(near)} and {len(names) - MAX_NAMES} more{all_of_them}"


def _continued(name: str, names: Iterable[str]) -> list[str]:
    """The names that begin with `name` and a hyphen."""
    return [other for other in names if other.startswith(f"{name}-")]


def dotted(location: Iterable[int | str]) -> str:
    """A location as a dotted path."""
    return ".".join(map(str, location))


def from_validation(
    error: pydantic.ValidationError, locate: Callable[[Location], str], siblings: Sequence[str] = ()
) -> ConfigError:
    """The first error of a pydantic validation, and the number of further errors, as one line.

    `locate` formats the location of a setting as `FILE: dotted.path`; `siblings` are names that are allowed
    at the top level in addition to the fields of the schema.
    """
    lines = error.errors(include_url=False)
    first = lines[0]
    others = len(lines) - 1 + sum(line.get("ctx", {}).get("others", 0) for line in lines)
    more = f" (and {others} more error{'s' * (others > 1)})" if others else ""
    where = locate(first["loc"]).removesuffix(": ")  # a check of a whole file has no path
    return ConfigError(f"{where}: {_message(first, siblings)}{more}")


_EXPECTED = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "an integer"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a mapping"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "finite_number": "a finite number",
    "string_type": "text",
    "string_too_short": "text that is not empty",
    "none_required": "null",
}
"""The values allowed, by the type of a pydantic error."""

_BOUNDS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than": ("lt", "<"),
    "less_than_equal": ("le", "<="),
    "multiple_of": ("multiple_of", "a multiple of"),
}


def _message(line: Any, siblings: Sequence[str]) -> str:
    kind, context, value = line["type"], line.get("ctx", {}), line["input"]
    if kind == "unknown_key":
        names = [*context["names"], *(siblings if len(line["loc"]) == 1 else ())]
        name, kinds = line["loc"][-1], context["kinds"]
        key = "experiment" if context["role"] == "experiment" else "kind"
        owners = f" (a setting of {key}={listed(name, kinds, LIST)})" if kinds else ""
        below = _below(line["loc"], names, context["open"])
        return f"unknown key{owners}{allowed_names(name, names)}{below}"
    if kind == "missing" and isinstance(line["loc"][-1], int):
        return f"missing; the list {shown(value)} is too short"
    if kind == "missing":
        return "missing; this setting has no default"
    got = f"got {shown(value)}; "
    if kind == "unknown_kind":
        got = f"got {shown(value.get('kind', value) if isinstance(value, dict) else value)}; "
        is_known = context["role"] in context["roles"]
        what = "not allowed here" if is_known else "unknown " + context["role"]
        if not is_known and context["roles"]:
            what = f"this name has the role {' and '.join(context['roles'])}, not {context['role']}"
            if {context["role"], *context["roles"]} >= {"problem", "env"}:
                what += "; planners need a problem, learners an env (experiment: learning)"
        return got + what + allowed_names(context["kind"], context["names"], LIST) + _several(context["kind"])
    if kind == "literal_error":
        allowed = context["expected"].replace("'", '"')
        names = [name.strip('"') for name in allowed.replace(" or ", ", ").split(", ")]
        return got + f"allowed: {allowed}" + (did_you_mean(value, names) if isinstance(value, str) else "")
    if kind in _BOUNDS:
        key, sign = _BOUNDS[kind]
        return got + f"allowed: {sign} {context[key]:.15g}"
    if kind in ("too_short", "too_long"):
        sign, key = (">=", "min_length") if kind == "too_short" else ("<=", "max_length")
        return got + f"allowed: {sign} {context[key]} entries"
    if kind in _EXPECTED:
        if _EXPECTED[kind] == "an integer" and (whole := _whole(value)):
            return got + f"allowed: an integer (write {whole})"
        return got + f"allowed: {_EXPECTED[kind]}" + _several(value)
    return got + one_line(line["msg"].removeprefix("Value error, "))


def _whole(value: Any) -> str:
    """The integer that is meant by 1e3, or by 1_000, which is text in YAML; empty if there is none."""
    if isinstance(value, float) and value.is_integer():
        return f"{value:.0f}"
    if isinstance(value, str) and re.fullmatch(r"[-+]?\d{1,3}(_\d{3})+", value, re.ASCII):
        return value.replace("_", "")
    return ""


def _several(value: Any) -> str:
    """A hint for values with commas between them, which other programs take for a sweep."""
    is_list = isinstance(value, str) and re.fullmatch(r"[\w.:+-]+(,[\w.:+-]+)+", value)
    return "; several values are an axis of a sweep file (axes: {KEY: [...]})" if is_list else ""


def _below(location: Location, names: Sequence[str], mappings: Sequence[str]) -> str:
    """A hint for a key that was probably meant for a mapping of free keys, such as `kwargs`."""
    if not mappings or did_you_mean(location[-1], names):
        return ""
    return f'; did you mean "{dotted((*location[:-1], mappings[0], location[-1]))}"?'
