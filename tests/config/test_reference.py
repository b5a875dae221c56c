"""The generated page of settings."""

from pathlib import Path

from bojax.config.reference import page

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"


def test_the_page_is_up_to_date():
    assert PAGE.read_text() == page(), "run: python -m bojax.config.reference > docs/settings.md"
