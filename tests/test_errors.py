"""Errors that a user can act on."""

import pickle

import pytest

from bojax.config.errors import ConfigError
from bojax.config.extras import MissingExtra
from bojax.engine.errors import EngineError
from bojax.errors import FAILURE, UserError
from bojax.results.store import ResultsError


@pytest.mark.parametrize(
    "error",
    [
        ConfigError("wrong"),
        ResultsError("full", FAILURE),
        EngineError("ended", FAILURE),
        MissingExtra.of("rasterio", "geo"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_process_hands_an_error_on_with_its_message_and_exit_code(error):
    found = pickle.loads(pickle.dumps(error))
    assert isinstance(found, UserError) and type(found) is type(error)
    assert (str(found), found.exit_code) == (str(error), error.exit_code)
