"""The pages say what is true: their files exist, their commands are understood, their tables are complete."""

import re
from functools import reduce
from operator import attrgetter
from pathlib import Path

import pytest
import yaml

from bojax.cli import main as cli
from bojax.config import catalog
from bojax.config.claims import Agrees, Growth, Mean, Order, Ratio, Share, Similar, Trend, Window
from bojax.config.component import registry
from bojax.config.describe import settings_of
from bojax.config.files import EXPERIMENT
from bojax.config.places import look_up
from bojax.config.settings import EngineConfig, Settings
from bojax.config.sweep import Report, SweepFile, load_config, load_sweep
from bojax.engine.build import build
from bojax.engine.manifest import timings
from bojax.engine.runner import evaluation
from bojax.experiments.settings import Learning, Planning
from bojax.problems.settings import FieldProblem
from bojax.report.figures import FIGURES
from tests.examples.pages import PAGES, ROOT, blocks, commands, links

DOCS = ROOT / "docs"
SHOWN = [(page, content, file) for page in PAGES for _, content, file in blocks(page) if file]
COMMANDS = [(page.name, words) for page in PAGES for words in commands(page) if words[0] == "bojax"]


def names_in(page) -> set[str]:
    """Everything that stands in backticks in the text of a page."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return set(re.findall(r"`([^`\n]+)`", text))


@pytest.mark.parametrize(("page", "content", "file"), SHOWN, ids=[file for _, _, file in SHOWN])
def test_a_block_is_the_file_that_it_shows(page, content, file):
    assert content == (ROOT / file).read_text()


def test_every_example_is_shown():
    shown = {ROOT / file for _, _, file in SHOWN}
    assert shown == {path for path in (ROOT / "examples").iterdir() if path.is_file()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    assert [target for target in links(page) if not (page.parent / target).exists()] == []


def test_every_page_is_in_the_navigation_and_in_both_lists():
    pages = {page.name for page in DOCS.glob("*.md")}
    navigation = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    assert sorted(file for entry in navigation for file in entry.values()) == sorted(pages)
    assert {target.removeprefix("docs/") for target in links(ROOT / "README.md")} >= pages - {"index.md"}
    assert set(links(DOCS / "index.md")) >= pages - {"index.md"}


@pytest.mark.parametrize(("page", "words"), COMMANDS, ids=[" ".join(words) for _, words in COMMANDS])
def test_a_command_is_understood(page, words, monkeypatch, capsys, tmp_path):
    """Up to the point where a sweep would be run; the learner that is evaluated is one of mountain car."""
    asked = []
    monkeypatch.setattr("bojax.cli.running._run", lambda sweeps, *_: asked.extend(sweeps) or 0)
    monkeypatch.setattr("bojax.cli.reporting.main", lambda *_: 0)
    monkeypatch.setattr("bojax.cli.rendering.main", lambda *_: 0)
    monkeypatch.setattr("bojax.cli.doctor.main", lambda *_: 0)
    monkeypatch.chdir(ROOT / "examples" if any("my_" in word for word in words) else ROOT)
    for word in words:
        if "/learners/" in word:
            monkeypatch.chdir(tmp_path)
            Path(word).mkdir(parents=True)
            config = load_config("mountain-car").points[0].config.model_dump(mode="json")
            Path(word, EXPERIMENT).write_text(yaml.safe_dump(evaluation(config)))
    assert cli.main(words[1:]) == 0, capsys.readouterr().err
    assert asked or words[1] not in ("run", "sweep")


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    used = {words[1] for page in PAGES for words in commands(page) if words[0] == "make"}
    assert {"run", "test"} <= used <= targets


def test_the_configuration_page_names_every_key():
    claims = (Order, Ratio, Share, Similar, Mean, Trend, Agrees, Growth)
    schemas = (Settings, EngineConfig, SweepFile, Report, Window, *claims)
    keys = {setting.name for schema in schemas for setting in settings_of(schema)}
    kinds = {kind for role in catalog.roles() for kind in registry.get(role, {})}
    tests = {test.model_fields["kind"].default for test in claims}
    known = {"by", "label"}  # said in a sentence: `by: variant`
    assert keys - known | kinds - {"toy"} | tests | set(FIGURES) <= names_in(DOCS / "configuration.md")


def test_the_configuration_page_shows_files_that_load(tmp_path):
    experiment, kernel, learning, axes, claims = (
        yaml.safe_load(c) for k, c, _ in blocks(DOCS / "configuration.md") if k == "yaml"
    )
    path = tmp_path / "shown.yaml"
    path.write_text(yaml.safe_dump(experiment))
    assert load_config(str(path)).points[0].config.planner.motions.turn_angle == 1.0
    path.write_text(yaml.safe_dump(kernel))
    assert load_config(str(path)).points[0].config.problem.kernel.first.kernel.lengthscale == (1.0, 2.0)
    path.write_text(yaml.safe_dump(learning))
    shown = load_config(str(path))
    assert shown.record.learners and shown.points[0].config.schedule.episodes == 30
    path.write_text(yaml.safe_dump({"base": "parking"} | axes | claims))
    sweep = load_sweep(str(path))
    assert [point.variant for point in sweep.points[::2]] == ["kcbts", "patient", "sbo-17"]


def test_the_configuration_page_tells_the_settings_of_learning():
    """Those of the experiment, of schedules and of tabular environments, with their defaults."""
    text = (DOCS / "configuration.md").read_text().partition("### Learning\n")[2].partition("\n### ")[0]
    told = {}
    for cells in (row.split("|")[1:-1] for row in re.findall(r"^\| `.+$", text, re.MULTILINE)):
        name, *kinds = re.findall(r"`([^`]+)`", " ".join(cells[:-2]))
        if "all three" in cells[1]:
            kinds = ["cliff-walking", "taxi", "chain"]
        told |= {(kind, name): cells[-2].strip(" `") for kind in kinds or ["learning"]}
    schemas = {"learning": Learning} | catalog.kinds("schedule")
    schemas |= {kind: schema for kind, schema in catalog.kinds("env").items() if kind in ("taxi", "chain")}
    schemas["cliff-walking"] = catalog.kinds("env")["cliff-walking"]
    assert told == {
        (kind, name): "required" if field.is_required() else _cell(field.default)
        for kind, schema in schemas.items()
        for name, field in schema.model_fields.items()
        if name != "kind"
    }


def test_the_results_page_names_every_column():
    configs = [load_config(name).points[0].config for name in ("parking", "two-pits", "mountain-car")]
    configs.append(load_sweep("table-5.1").points[0].config)
    tables = [table for config in configs for table in build(config).tables.values()]
    columns = {re.sub(r"^(observation|action)_\d+$", r"\1_0", column.name) for t in tables for column in t}
    assert columns | set(timings([]).column_names) <= names_in(DOCS / "results.md")


def test_settings_named_beside_symbols_exist():
    found = [
        name
        for name in names_in(DOCS / "notation.md")
        if re.fullmatch(r"(planner|problem|env|learner|schedule)(\.\w+)+", name)
    ]
    assert len(found) > 20
    problems = [{"kind": "planning"}, {"kind": "planning", "problem": {"kind": "monitoring"}}]
    learning = {"kind": "learning", "env": "chain", "schedule": "decay"}
    problems += [{**learning, "learner": name} for name in catalog.kinds("learner")]
    missing = [path for path in found if all(look_up(p, path.split(".")) is None for p in problems)]
    assert missing == []


def test_the_monitoring_page_tells_the_problems():
    text = (DOCS / "monitoring.md").read_text()
    table = re.search(r"^\| setting \| (.+) \|\n\|[-|]+\n((?:\|.+\n)+)", text, re.MULTILINE)
    assert table
    problems = [Planning.model_validate({"problem": name.strip(" `")}) for name in table[1].split("|")]
    rows = [[cell.strip(" `") for cell in row.strip("|").split("|")] for row in table[2].splitlines()]
    assert len(rows) > 10
    for path, *told in rows:
        assert told == [_cell(reduce(_attribute, path.split("."), problem)) for problem in problems], path


def test_the_monitoring_page_names_every_setting():
    text = (DOCS / "monitoring.md").read_text()
    named = set(re.findall(r"problem\.(\w+)", text))
    assert {setting.name for setting in settings_of(FieldProblem)} <= named
    kinds = {kind for role in ("field", "objective", "planner") for kind in catalog.kinds(role)}
    assert kinds - {"toy"} <= names_in(DOCS / "monitoring.md")


def _attribute(part, name):
    return getattr(part, name, "-")


def _cell(value) -> str:
    """A default as the page writes it."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_cell, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    value = getattr(value, "kind", value)  # a part
    return "null" if value is None else value if isinstance(value, str) else f"{value:g}"


@pytest.mark.parametrize(
    ("part", "least", "experiment"),
    [
        ("Planning and parking", 15, {}),
        ("Monitoring", 8, {"problem": "space-modelling"}),
    ],
)
def test_the_notes_on_the_thesis_tell_the_defaults(part, least, experiment):
    text = (DOCS / "thesis-notes.md").read_text().partition(f"### {part}\n")[2].partition("\n#")[0]
    rows = re.findall(r"^\| [^|]+ \| (`(?:planner|problem)\.[^|]+) \| ([^|]+) \|$", text, re.MULTILINE)
    assert len(rows) > least
    defaults = Planning.model_validate(experiment)
    for settings, told in rows:
        path = ""
        for name in re.findall(r"`([^`]+)`", settings):
            path = path.rpartition(".")[0] + name if name.startswith(".") else name
            default = attrgetter(path)(defaults)
            words = {True: "yes", False: "no"}.get(default) if isinstance(default, bool) else None
            words = (
                words
                or getattr(default, "kind", None)
                or (default if isinstance(default, str) else f"{default:g}")
            )
            expected = {"0": r"\b(0|no)\b", "1e-05": "1e-5"}.get(words, rf"(?<![\w.]){re.escape(words)}\b")
            assert re.search(expected, told), f"{path} is {default}, but the page says: {told}"
