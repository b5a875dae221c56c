"""Settings come back from the manifest as the objects that were written into it."""

import json

import pytest

from bojax import __version__
from bojax.cli.main import main
from bojax.config.files import available
from bojax.config.sweep import load_config, load_sweep, validate_experiment
from bojax.engine.plan import plain
from bojax.report.build import build_report
from bojax.report.manifest import Manifest, PointEntry, Unread, claims_of, experiment_of
from bojax.report.source import load
from tests.report.synthetic import edit_manifest, write_monitoring, write_results

SHIPPED = [
    (load, name)
    for load, kind in ((load_config, "configs"), (load_sweep, "sweeps"))
    for name in available(kind)
]


def test_shipped_settings_survive_the_manifest():
    for read, name in SHIPPED:
        sweep = read(name)
        written = json.loads(json.dumps({"claims": plain(sweep.claims), "report": plain(sweep.report)}))
        manifest = Manifest.model_validate(
            {"status": "finished", "points": [{"index": 0, "label": "x"}], **written}
        )
        assert claims_of(manifest) == sweep.claims, name
        for point in sweep.points:
            config = json.loads(json.dumps(plain(point.config)))
            assert experiment_of(PointEntry(index=0, label="x", config=config)) == point.config, name


def test_settings_of_another_version_leave_a_page_that_says_so(tmp_path):
    folder = write_results(tmp_path / "results", runs=20, recorded=2)
    edit_manifest(folder, lambda m: m["points"][0]["config"]["planner"].update(cleverness=3))
    results = load(folder)
    assert isinstance(results.points[0].experiment, Unread) and results.points[0].outline.border is None
    page = build_report(folder).read_text()
    assert "This version of bojax cannot read the settings of kcbts (planner.cleverness: unknown" in page


COMMANDS = ("report", "compare", "best", "export --to csv")


@pytest.mark.parametrize("command", COMMANDS)
def test_results_that_another_version_wrote_are_read_and_a_line_says_so(here, capsys, command):
    folder = write_results(here / "results", runs=3, recorded=0, report={"figures": []})
    edit_manifest(folder, lambda m: m["versions"].update(bojax="99.1"))
    assert main([*command.split(), "results"]) == 0
    assert capsys.readouterr().err.startswith(
        f"note: results was written by bojax 99.1; this is {__version__}\n"
    )


@pytest.mark.parametrize("command", COMMANDS[1:])
@pytest.mark.parametrize(
    "edit",
    [lambda point: point.pop("config"), lambda point: point["config"].pop("kind")],
    ids=["config", "kind"],
)
def test_settings_that_are_missing_are_one_line(here, refusal, command, edit):
    folder = write_results(here / "results", runs=3, recorded=0)
    edit_manifest(folder, lambda m: edit(m["points"][0]))
    expected = "results: this version of bojax cannot read the settings of kcbts (settings: got {"
    assert refusal(f"{command} results").startswith(expected)


def test_parts_by_import_path_are_named(tmp_path):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=0)
    edit_manifest(folder, lambda m: m["points"][0]["config"]["problem"].update(kind="mine:Dock"))
    assert "mine:Dock: given by import path" in build_report(folder).read_text()


def test_files_of_data_are_not_read_again(here, monkeypatch):
    (here / "depth.csv").write_text("0,1\n2,3\n")
    field = {"kind": "grid", "file": "depth.csv", "extent": [0.0, 0.0, 1.0, 1.0]}
    config = validate_experiment({"kind": "planning", "problem": {"kind": "two-pits", "field": field}})
    recorded = PointEntry(index=0, label="x", config=json.loads(json.dumps(plain(config))))
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert experiment_of(recorded) == config
    (here / "elsewhere" / "depth.csv").write_text("4,5\n6,7\n")  # another file of the same name
    assert experiment_of(recorded) == config
