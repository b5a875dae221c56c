"""The generated pages of settings."""

from pathlib import Path

from bojax.config.catalog import roles
from bojax.config.reference import _PAGES, pages

DOCS = Path(__file__).parents[2] / "docs"


def test_the_pages_are_up_to_date():
    shown = {str(path.relative_to(DOCS)) for path in (DOCS / "settings").iterdir()} | {"settings.md"}
    assert shown == set(pages())
    for path, text in pages().items():
        assert (DOCS / path).read_text() == text, "run: python -m bojax.config.reference"


def test_every_role_is_on_one_page():
    assert sorted(role for _, names in _PAGES.values() for role in names) == sorted(roles())
