"""What tests of whole sweeps share."""

from collections.abc import Iterator

import pytest

from bojax.engine import program_cache


@pytest.fixture(scope="module")
def kept_toys() -> Iterator[None]:
    """Programs of toys stay in memory: of the equal sweeps of a file, the first alone traces and compiles.

    As in the rounds of a search. Nothing is saved, since a toy that is edited keeps its name.
    """
    with pytest.MonkeyPatch.context() as patch, program_cache.held():
        patch.setattr(program_cache, "_KNOWN", {*program_cache._KNOWN, "tests"})
        patch.setattr(program_cache, "write", lambda *_: False)
        yield


@pytest.fixture
def compiles_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """A test with `kept_toys` for which no program has been compiled yet."""
    monkeypatch.setattr(program_cache, "_held", {})
