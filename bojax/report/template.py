"""Fills the templates of pages."""

import re
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


def fill(template: str, /, **values: Any) -> str:
    """The text of a template of this package; HTML templates escape what is filled in."""
    environment = Environment(
        loader=PackageLoader("bojax.report"),
        autoescape=template.endswith(".html.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters.update(minus=_minus, markdown=_markdown)
    return environment.get_template(template).render(**values)


def _minus(text: Any) -> str:
    """Replace hyphens before digits by minus signs, as numbers are typeset."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", str(text))


def _markdown(text: Any) -> str:
    """A text on one line of Markdown or in a cell of its tables, its special characters escaped."""
    plain = " ".join(str(text).split()).replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"([\\`*_|])", r"\\\1", plain)
