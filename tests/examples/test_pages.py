"""The pages are true: their files exist, their commands are understood, their links lead somewhere."""

import importlib
import re
from pathlib import Path

import yaml

from bojax.cli import main as cli
from bojax.config.files import EXPERIMENT
from bojax.config.sweep import load_config, load_sweep
from bojax.engine.build import build
from bojax.engine.learners import evaluation
from bojax.experiments.settings import Learning
from bojax.results.merge import _timings
from tests.examples.pages import PAGES, ROOT, blocks, commands, links

DOCS = ROOT / "docs"
REFERENCE = {
    *("docs/results.md", "docs/reproduction.md", "docs/surveys-league.md"),
    *(page.relative_to(ROOT).as_posix() for page in (DOCS / "settings").iterdir()),
    *(page.relative_to(ROOT).as_posix() for page in (DOCS / "reproduction").glob("chapter*.md")),
    *(page.relative_to(ROOT).as_posix() for page in (DOCS / "reproduction").glob("multiverse-*.md")),
}
"""Pages to look something up in, which may be long."""
SHOWN = [(content, file) for page in PAGES for _, content, file in blocks(page) if file]
COMMANDS = {tuple(words): None for page in PAGES for words in commands(page) if words[0] == "bojax"}


def names_in(page) -> set[str]:
    """Everything that stands in backticks in the text of a page."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return set(re.findall(r"`([^`\n]+)`", text))


def test_every_program_of_the_examples_is_shown_as_it_is_and_links_lead_somewhere():
    for content, file in SHOWN:
        assert content == (ROOT / file).read_text(), file
    data = (".csv", ".geojson", ".ipynb")
    files = {path for path in (ROOT / "examples").iterdir() if path.is_file() and path.suffix not in data}
    assert files <= {ROOT / file for _, file in SHOWN}
    for page in PAGES:
        assert [target for target in links(page) if not (page.parent / target).exists()] == [], page


def test_pages_are_short():
    """A how-to takes less than a minute to read; only reference, found by its anchors, is longer."""
    assert len((ROOT / "README.md").read_text().split()) <= 700
    for page in PAGES:
        words = len(page.read_text().split())
        if page.parent.name == "howto":
            assert words <= 200, page
        elif page.relative_to(ROOT).as_posix() not in REFERENCE:
            assert words <= 3000, page


def test_numbered_lists_begin_with_1():
    """The site numbers the items of every list from 1."""
    for page in PAGES:
        assert set(re.findall(r"^\n(\d+)\. ", page.read_text(), re.MULTILINE)) <= {"1"}, page


def test_every_page_is_in_the_navigation():
    shown = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert sorted(shown) == sorted(page.relative_to(DOCS).as_posix() for page in PAGES[1:])


def test_the_readme_counts_claims_as_the_page_of_the_reproduction():
    page = (DOCS / "reproduction.md").read_text()
    bound = r"(\d+) of them rest on a bound"
    counts = re.search(
        rf"(\d+) claims, tested by .*: (\d+) reproduced, (\d+) not .* (\d+) inconclusive; {bound}", page
    )
    told = " ".join((ROOT / "README.md").read_text().split())
    shown = re.search(
        rf"Of (\d+) claims .* (\d+) are reproduced, (\d+) are not, and (\d+) are inconclusive; {bound}", told
    )
    assert counts and shown and counts.groups() == shown.groups()


def test_every_command_is_understood(monkeypatch, capsys, tmp_path):
    for number, words in enumerate(COMMANDS):
        folder = tmp_path / str(number)
        folder.mkdir()
        with monkeypatch.context() as patch:
            understand(list(words), patch, capsys, folder)


def understand(words, monkeypatch, capsys, folder):
    """Up to the point where a sweep would be run; the learner that is evaluated is one of mountain car."""
    asked = []
    # First: these modules import `run`, which they would keep if they were imported after the next patch.
    import bojax.cli.multiverse  # noqa: F401

    for runs_elsewhere in ("bench", "reporting", "best", "rendering", "doctor", "status", "worker"):
        monkeypatch.setattr(f"bojax.cli.{runs_elsewhere}.main", lambda *_: 0)
    for function in ("running.run", "reproducing.run", "multiverse.run"):
        monkeypatch.setattr(f"bojax.cli.{function}", lambda sweeps, *_, **__: asked.extend(sweeps) or 0)
    monkeypatch.setattr("bojax.report.comparing.build.compare", lambda folders, files, out, *_: out)
    monkeypatch.setattr("bojax.report.exporting.export", lambda folder, target, out: folder)
    monkeypatch.setattr("bojax.cli.tuning.search", lambda *_: 0)
    monkeypatch.setattr("bojax.cli.survey.plan", lambda *_: 0)
    monkeypatch.setattr("bojax.claims.reproduction.joined_reproduction", lambda *_: [])
    monkeypatch.chdir(ROOT / "examples" if any("my_" in word for word in words) else ROOT)
    for word in words:
        if word.endswith("/best.yaml"):
            monkeypatch.chdir(folder)
            Path(word).parent.mkdir(parents=True)
            Path(word).write_text("experiment: planning\n")
        if "/learners/" in word:
            monkeypatch.chdir(folder)
            Path(word).mkdir(parents=True)
            config = load_config("mountain-car").points[0].config.model_dump(mode="json")
            Path(word, EXPERIMENT).write_text(yaml.safe_dump(evaluation(config)))
    if "--cluster" in words:
        monkeypatch.chdir(folder)
        slurm, ray = (content for kind, content, _ in blocks(DOCS / "clusters.md") if kind == "yaml")
        Path("cluster.yaml").write_text(slurm if "slurm" in words else ray)
    assert cli.main(words[1:]) == 0, (words, capsys.readouterr().err)
    assert asked or words[1] not in ("run", "sweep", "reproduce") or {"--dry-run", "--page"} & set(words)


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    used = {words[1] for page in PAGES for words in commands(page) if words[0] == "make"}
    assert {"run", "test"} <= used <= targets


def test_the_pages_of_configuration_and_claims_show_files_that_load(tmp_path):
    experiment, kernel, learning, axes, claims, explanations = (
        yaml.safe_load(content)
        for page in ("configuration.md", "claims.md")
        for kind, content, _ in blocks(DOCS / page)
        if kind == "yaml"
    )
    path = tmp_path / "shown.yaml"
    path.write_text(yaml.safe_dump(experiment))
    assert load_config(str(path)).points[0].config.planner.motions.turn_angle == 1.0
    path.write_text(yaml.safe_dump(kernel))
    assert load_config(str(path)).points[0].config.problem.kernel.first.kernel.lengthscale == (1.0, 2.0)
    path.write_text(yaml.safe_dump(learning))
    shown = load_config(str(path))
    assert shown.record.learners and shown.points[0].config.schedule.episodes == 30
    path.write_text(yaml.safe_dump({"base": "parking"} | axes | claims | explanations))
    sweep = load_sweep(str(path))
    assert [point.variant for point in sweep.points[::2]] == ["kcbts", "patient", "sbo-17"]


def test_the_page_of_gymnasium_shows_settings_that_load():
    shown = [yaml.safe_load(text) for kind, text, _ in blocks(DOCS / "gymnasium.md") if kind == "yaml"]
    for kind in ("gymnasium", "brax"):
        (env,) = [part["env"] for part in shown if part["env"]["kind"] == kind]
        assert Learning.model_validate({"env": env, "learner": "emu-q"}).env.kind == kind


def test_the_results_page_names_every_column():
    configs = [load_config(name).points[0].config for name in ("parking", "two-pits", "mountain-car")]
    configs.append(load_sweep("table-5.1").points[0].config)
    tables = [table for config in configs for table in build(config).tables.values()]
    columns = {re.sub(r"^(observation|action)_\d+$", r"\1_0", column.name) for t in tables for column in t}
    assert columns | set(_timings({}, {}).column_names) <= names_in(DOCS / "results.md")


def test_the_code_of_an_equation_exists():
    for name in sorted(name for name in names_in(DOCS / "equations.md") if name.count(".") > 1):
        module, *inside = name.split(".")[1:]
        found = importlib.import_module(f"bojax.{name.split('.')[0]}.{module}")
        for part in inside:
            found = getattr(found, part)
        assert callable(found) or isinstance(found, property), name
