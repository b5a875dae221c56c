"""What tests of reports share."""

import pytest
from matplotlib.figure import Figure

from bojax.report import style


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, and encoded as empty ones: for tests of what a report says, not of how it looks."""
    blank = style.encode(Figure(figsize=(1, 1)))
    monkeypatch.setattr(style, "encode", lambda _: blank)
