"""A user's folder, as in the tests of configurations."""

from tests.config.conftest import write as write
