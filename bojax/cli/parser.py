"""Argument parsing whose errors are one line, with the nearest name."""

import argparse
from typing import NoReturn

from typing_extensions import override

from bojax.config.errors import did_you_mean


class UsageError(Exception):
    """A command line that means nothing, told in one line.

    Attributes:
        exit_code: What the command line exits with.
    """

    exit_code = 2


class Parser(argparse.ArgumentParser):
    """An argument parser that raises `UsageError` where argparse prints its usage and leaves."""

    def __init__(self, *, prog: str, usage: str, description: str, examples: str):
        super().__init__(
            prog=prog,
            usage=usage,
            description=description,
            epilog=f"examples:\n{examples}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    @override
    def error(self, message: str) -> NoReturn:
        """Raise the mistake that argparse has found."""
        unknown = message.removeprefix("unrecognized arguments: ")
        if unknown != message:
            name = unknown.split()[0].partition("=")[0]
            options = [option for option in self._option_string_actions if option.startswith("--")]
            message = f"unknown option {name}{did_you_mean(name, options)}"
        raise UsageError(f"{message.removeprefix('argument ')} (see: {self.prog} --help)")


def integer(text: str) -> int:
    """An argument that is an integer."""
    try:
        return int(text)
    except ValueError:
        hint = f": write {float(text):.0f}" if _is_integral(text) else ""
        raise argparse.ArgumentTypeError(f"got {text}; an integer is expected{hint}") from None


def _is_integral(text: str) -> bool:
    """Whether a text is an integer in the writing of floats, such as 1e3."""
    try:
        return float(text).is_integer()
    except (ValueError, OverflowError):
        return False
