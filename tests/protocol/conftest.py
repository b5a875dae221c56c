"""The data files of the parts that need some lie in the working directory."""

import pytest

from tests.parts import FILES


@pytest.fixture(autouse=True)
def data_files(here):
    """Write them below an empty working directory."""
    for name, text in FILES.items():
        (here / name).write_text(text)
