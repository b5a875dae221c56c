"""What the page on learning says of learners and features is so."""

import re

from bojax.config import catalog
from bojax.config.describe import settings_of
from tests.examples.pages import ROOT
from tests.examples.test_pages import names_in

PAGE = ROOT / "docs" / "learning.md"
TABULAR = ("exploration-values", "additive", "epsilon-greedy")


def rows_of(header: str) -> list[list[str]]:
    """The cells of the table with this header."""
    table = re.search(rf"^\| {header} .*\n\|[-|]+\n((?:\|.+\n)+)", PAGE.read_text(), re.MULTILINE)
    assert table, header
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table[1].splitlines()]


def default(kind: str, name: str) -> str:
    """A default as the page writes it."""
    value = catalog.kinds("learner")[kind].model_fields[name].default
    value = getattr(value, "kind", value)
    return (
        str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else f"{value:g}"
    )


def test_the_settings_of_tabular_learners_and_their_defaults():
    told = {}
    for name, of, value, _ in rows_of(r"setting \| of"):
        kinds = TABULAR if of == "all" else re.findall(r"`([^`]+)`", of)
        told |= {(kind, name.strip("`")): value for kind in kinds}
    schemas = catalog.kinds("learner")
    assert told == {
        (kind, setting.name): default(kind, setting.name)
        for kind in TABULAR
        for setting in settings_of(schemas[kind])
    }


def test_the_settings_of_emu_q_in_both_presets():
    told = {name.strip("`"): values for name, *values, _ in rows_of(r"setting \| `emu-q`")}
    for column, kind in enumerate(("emu-q", "emu-q-published")):
        assert {name: values[column] for name, values in told.items()} == {
            setting.name: default(kind, setting.name)
            for setting in settings_of(catalog.kinds("learner")[kind])
        }


def test_the_settings_of_rff_q():
    told = {name.strip("`"): value for name, value, _ in rows_of("setting of `rff-q`")}
    settings = settings_of(catalog.kinds("learner")["rff-q"])
    assert told == {setting.name: default("rff-q", setting.name) for setting in settings}


def test_every_kind_and_every_setting_of_features_is_named():
    named = names_in(PAGE)
    for role in ("learner", "schedule", "exploration-reward", "features"):
        assert set(catalog.kinds(role)) <= named
    features = rows_of("`features`")
    for kind, settings, _ in features:
        for setting in settings_of(catalog.kinds("features")[kind.strip("`")]):
            assert re.search(rf"`{setting.name}`[^(]*\([^)]*{re.escape(setting.default)}\b", settings), (
                setting
            )
