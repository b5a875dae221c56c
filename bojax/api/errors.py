"""Errors that a Python caller gets: one line each."""

from collections.abc import Iterator
from contextlib import contextmanager

from bojax.config.overrides import SOURCE
from bojax.errors import UserError


class BojaxError(Exception):
    """A sweep or a results folder cannot be used; the message is one line.

    Attributes:
        output: What the process of the sweep printed, such as a traceback.
    """

    def __init__(self, message: str, output: str = ""):
        super().__init__(message)
        self.output = output


class Interrupted(KeyboardInterrupt):
    """A sweep was stopped by Ctrl-C; the message says how to resume."""


@contextmanager
def in_one_line() -> Iterator[None]:
    """Turn errors that the command line prints as one line into a `BojaxError`."""
    try:
        yield
    except UserError as error:
        raise BojaxError(str(error).removeprefix(f"{SOURCE}: ")) from None
