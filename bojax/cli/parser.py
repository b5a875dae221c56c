"""An argument parser with one-line errors."""

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from typing_extensions import override

from bojax.config.errors import ConfigError, allowed_names, control_character, did_you_mean, shown
from bojax.config.yaml_file import parse
from bojax.errors import UserError


class UsageError(UserError):
    """An invalid command line."""


class Parser(argparse.ArgumentParser):
    """An argument parser of a command that raises a `UsageError` instead of printing the usage and exiting.

    The name is empty for `bojax` itself; `usage` is what follows it.
    """

    def __init__(self, name: str, usage: str, description: str, examples: str):
        prog = f"bojax {name}".strip()
        super().__init__(
            prog=prog,
            usage=f"{prog} {usage}".strip(),
            description=description,
            epilog=f"examples:\n{examples}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def option(
        self, name: str, metavar: str, help: str, type: Callable[[str], Any] = str, **more: Any
    ) -> None:
        """Add an option with a value, or an argument if the name has no dashes."""
        self.add_argument(name, metavar=metavar, help=help, type=type, **more)

    def flag(self, name: str, help: str) -> None:
        """Add an option without a value."""
        self.add_argument(name, action="store_true", help=help)

    def read(self, words: Sequence[str]) -> argparse.Namespace:
        """The arguments among the words of a command line.

        Raises:
            UsageError: An argument is wrong.
        """
        joined: list[str] = []
        for word in words:
            if re.match(r"-[\d.]", word) and joined and re.fullmatch("--[a-z-]+", joined[-1]):
                joined[-1] += f"={word}"  # argparse takes -3.2,51.1 for an option
            else:
                joined.append(word)
        return self.parse_intermixed_args(joined)

    @override
    def error(self, message: str) -> NoReturn:
        """Raise an error of argparse; for an unknown option, with the nearest name."""
        unknown = message.removeprefix("unrecognized arguments: ")
        if unknown != message:
            message = f"unknown option {self._unknown(unknown.split()[0])}"
        raise UsageError(f"{message.removeprefix('argument ')} (see: {self.prog} --help)")

    def _unknown(self, word: str) -> str:
        """The name of an unknown option, and what may be meant."""
        name, equals, value = word.partition("=")
        if name in ("--gpu", "--gpus", "--cuda", "--cpu"):
            hint = (
                "GPUs are used if JAX is installed for them (page Installation of the manual; bojax doctor "
            )
            return f"{name}; {hint}shows them); JAX_PLATFORMS=cpu in the environment uses none"
        setting = name.lstrip("-")
        if "key=value" in (self.usage or "") and ("." in setting or setting in _settings()):
            return f"{name}; did you mean {setting}={value if equals else 'VALUE'}?"
        options = [option for option in self._option_string_actions if option.startswith("--")]
        return name + did_you_mean(name, options)


def _settings() -> set[str]:
    """The top-level keys of a config."""
    from bojax.config.catalog import kinds
    from bojax.config.settings import RESERVED

    return {"experiment", *RESERVED}.union(*(schema.model_fields for schema in kinds("experiment").values()))


def integer(text: str) -> int:
    """Convert an argument to an integer, as written in YAML."""
    try:
        value = parse(text, "argument")
    except ConfigError:
        value = None
    if type(value) is not int:
        hint = f" (write {value:.0f})" if isinstance(value, float) and value.is_integer() else ""
        raise argparse.ArgumentTypeError(f"got {text}; allowed: an integer{hint}")
    return value


def at_least(least: int) -> Callable[[str], int]:
    """A function that converts an argument to an integer that is not below a bound."""

    def check(text: str) -> int:
        if (number := integer(text)) < least:
            raise argparse.ArgumentTypeError(f"got {number}; allowed: >= {least}")
        return number

    return check


def path(text: str) -> Path:
    """Convert an argument to a path; an empty one, as of an unset variable of a shell, is refused."""
    if not text:
        raise argparse.ArgumentTypeError("got an empty name; allowed: a path")
    if control_character(text, allows_breaks=False):
        raise argparse.ArgumentTypeError(f"got {shown(text)}; allowed: a path on one line")
    return Path(text)


def column(text: str) -> str:
    """A column of a table, which may follow a minus sign; an empty one is refused."""
    if not text.removeprefix("-"):
        raise argparse.ArgumentTypeError(f'got "{text}"; allowed: a column, such as return or -rmse')
    return text


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """A function that checks that an argument is one of some names."""

    def check(text: str) -> str:
        if text not in names:
            raise argparse.ArgumentTypeError(f"got {text}{allowed_names(text, names)}")
        return text

    return check
