"""Wrong input ends in one line."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest
from jaxtyping import config


@contextlib.contextmanager
def one_line(error: type[Exception], match: str | None = None) -> Iterator[None]:
    """The context ends in an error of one line, which matches the pattern."""
    with pytest.raises(error, match=match) as caught:
        yield
    assert "\n" not in str(caught.value), caught.value


def assert_refused(
    calls: Iterable[tuple[Callable[[], Any], str]], error: type[Exception] = ValueError
) -> None:
    """Each call raises an error of one line, which matches the pattern beside it."""
    for call, message in calls:
        with one_line(error, message):
            call()


@contextlib.contextmanager
def without_annotation_checks() -> Iterator[None]:
    """Values of wrong types reach the code, as in a user's process, where annotations are not checked."""
    config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        config.update("jaxtyping_disable", False)
