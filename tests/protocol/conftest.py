"""The data files of the parts that need some lie in the working directory."""

import pytest

from tests.parts import FILES


@pytest.fixture(autouse=True)
def data_files(tmp_path, monkeypatch):
    """Write them below an empty working directory."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
