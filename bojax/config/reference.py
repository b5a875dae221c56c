"""Generator of `docs/settings.md`: every part, with the type, default and meaning of its settings.

`python -m bojax.config.reference > docs/settings.md` writes the page.
"""

from collections.abc import Iterator, Mapping

import pydantic

from bojax.config.catalog import kinds, roles
from bojax.config.claims import Claim, Explanation, Window
from bojax.config.component import registry
from bojax.config.describe import settings_of, summary_of
from bojax.config.settings import EngineConfig, Record, Settings
from bojax.config.sweep_file import Report, SweepFile

_HEAD = """\
# Settings

This page is generated: `python -m bojax.config.reference > docs/settings.md`. `bojax list NAME` prints
the settings of one part in a terminal.

Every key of a configuration file is one of the settings below. A setting whose type is a role, such as
`kernel`, takes the name of a part of that role, or a mapping of `kind` and the settings of that part.
"""

_FILES: dict[str, type[pydantic.BaseModel]] = {
    "Keys of every file": Settings,
    "`record`": Record,
    "`engine`": EngineConfig,
    "Further keys of a sweep": SweepFile,
    "`report`": Report,
    "`explanations` of `report`": Explanation,
    "`claims`": Claim,
    "`window` and `since` of a test": Window,
}


def page() -> str:
    """The whole page, in Markdown."""
    return "\n".join(_lines())


def _lines() -> Iterator[str]:
    yield _HEAD
    yield "## Files\n"
    for title, schema in _FILES.items():
        yield f"### {title}\n"
        yield from _about(schema)
    for role, base in roles().items():
        yield f"## {base.plural.capitalize()}\n"
        own = "A class of your own, given as `module:Class`, derives from"
        protocol = f" {own} `{base.protocol.replace(':', '.')}`." if base.protocol else ""
        yield f"Role `{role}`.{protocol}\n"
        yield from _parts(kinds(role))
    yield "## Tests of claims\n"
    yield from _parts(registry["test"])


def _parts(schemas: Mapping[str, type[pydantic.BaseModel]]) -> Iterator[str]:
    for kind, schema in schemas.items():
        yield f"### `{kind}`\n"
        yield from _about(schema)


def _about(schema: type[pydantic.BaseModel]) -> Iterator[str]:
    yield f"{summary_of(schema)}\n"
    settings = settings_of(schema)
    if not settings:
        return
    yield "| setting | type | default | meaning |\n| --- | --- | --- | --- |"
    for setting in settings:
        cells = (f"`{setting.name}`", setting.type, setting.default or "required", setting.meaning)
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
    yield ""


if __name__ == "__main__":
    print(page(), end="")
