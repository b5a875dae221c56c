"""Exports: means and deviations are those of the tables, and the other libraries read them back."""

import csv
import json
import shutil
import struct
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from bojax.cli.main import main
from bojax.report.exporting import export, exported
from bojax.report.source import load
from bojax.report.text import exact
from tests.report.synthetic import edit_manifest, write_learning, write_results
from tests.transcript import cases


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    return write_learning(tmp_path_factory.mktemp("export") / "car", runs=5, episodes=6, tests=1)


@pytest.fixture(scope="module")
def points(car):
    return exported(load(car))


def curve(point, name):
    (found,) = [each for each in point.curves if each.name == name]
    return found


class TestContent:
    def test_curves_are_means_and_deviations_over_runs(self, car, points):
        results = load(car)
        for point, entry in zip(points, results.points, strict=True):
            values = results.by_episode(entry, "return")
            found = curve(point, "train/return")
            assert {"test/return", "train/length", "train/success"} <= {each.name for each in point.curves}
            assert found.axis == "episode" and found.x.tolist() == [1, 2, 3, 4, 5, 6]
            np.testing.assert_allclose(found.mean, values.mean(axis=0))
            np.testing.assert_allclose(found.deviation, values.std(axis=0, ddof=1), atol=1e-15)

    def test_a_run_that_ended_is_left_out_of_the_later_means(self, tmp_path):
        results = load(write_learning(tmp_path / "a", runs=4, episodes=5, tests=0))
        there = (results.episodes["run"] != 2) | (results.episodes["episode"] <= 3)
        results.__dict__["episodes"] = {key: each[there] for key, each in results.episodes.items()}
        values = results.by_episode(results.points[1], "return")
        found = curve(exported(results)[1], "train/return")
        np.testing.assert_allclose(found.mean, np.nanmean(values, axis=0))
        np.testing.assert_allclose(found.deviation, np.nanstd(values, axis=0, ddof=1), atol=1e-15)

    def test_planning_has_the_accumulated_reward_by_step(self, tmp_path):
        results = load(write_results(tmp_path / "parking", runs=6, recorded=0))
        point = exported(results)[0]
        (found,) = point.curves
        assert (found.name, found.axis, found.x[0], found.mean[0]) == ("accumulated_reward", "step", 0, 0)
        returns = results.runs_of(results.points[0])["return"]
        assert found.mean[-1] == pytest.approx(returns.mean())
        assert point.scalars["return"] == pytest.approx(returns.mean())
        assert point.scalars["return_std"] == pytest.approx(returns.std(ddof=1))

    def test_a_mean_over_some_runs_says_how_many(self, points):
        """RFF-Q does not reach the goal in run 1 of 5; epsilon-greedy never does."""
        emu_q, rff_q, epsilon_greedy = (point.scalars for point in points)
        assert "episodes_to_goal_runs" not in emu_q
        assert rff_q["episodes_to_goal_runs"] == 4 and rff_q["episodes_to_goal"] == pytest.approx(12.25)
        assert "episodes_to_goal" not in epsilon_greedy

    def test_settings_are_flat_and_have_all_their_digits(self, car, tmp_path):
        shutil.copytree(car, tmp_path / "car")
        numbers = {"discount": 0.123456789, "prior_precision": 2.0}
        edit_manifest(tmp_path / "car", lambda found: found["points"][0]["config"]["learner"].update(numbers))
        known = {"learner.discount": "0.123456789", "learner.prior_precision": "2", "learner.kind": "emu-q"}
        known |= {"runs": "5", "seed": "0"}
        assert known.items() <= exported(load(tmp_path / "car"))[0].settings.items()
        assert exact([0.1, 1 / 3]) == "0.1, 0.3333333333333333"

    def test_without_episodes_there_are_no_curves(self, car, points, tmp_path):
        shutil.copytree(car, tmp_path / "car")
        (tmp_path / "car" / "episodes.parquet").unlink()
        found = exported(load(tmp_path / "car"))
        assert [each.curves for each in found] == [[], [], []]
        assert [each.scalars for each in found] == [each.scalars for each in points]


def test_csv_files_hold_every_number(car, points, tmp_path):
    export(car, "csv", tmp_path / "out")
    rows = {
        path.stem: list(csv.DictReader(path.open(encoding="utf-8"))) for path in (tmp_path / "out").iterdir()
    }
    assert set(rows) == {"curves", "scalars", "settings"}
    assert len(rows["curves"]) == sum(each.x.size for point in points for each in point.curves)
    found = [row for row in rows["curves"] if (row["point"], row["curve"]) == ("rff-q", "train/return")]
    np.testing.assert_array_equal(
        [float(row["mean"]) for row in found], curve(points[1], "train/return").mean
    )
    scalars = {(row["point"], row["scalar"]): float(row["value"]) for row in rows["scalars"]}
    assert scalars["emu-q", "last_return"] == points[0].scalars["last_return"]
    assert {"point": "emu-q", "setting": "learner.kind", "value": "emu-q"} in rows["settings"]


def test_tensorboard_reads_its_files(car, points, tmp_path):
    pytest.importorskip("tensorboardX")
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    hparams = pytest.importorskip("tensorboard.plugins.hparams.plugin_data_pb2")
    out = export(car, "tensorboard", tmp_path / "out")
    folders = sorted(out.iterdir())
    assert [folder.name for folder in folders] == ["0-emu-q", "1-rff-q", "2-epsilon-greedy"]
    for point, folder in zip(points, folders, strict=True):
        reader = accumulators.EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
        for each in point.curves:
            for tag, values in ((each.name, each.mean), (f"{each.name}_std", each.deviation)):
                events = reader.Scalars(tag)
                assert [event.step for event in events] == each.x.tolist()
                np.testing.assert_allclose([event.value for event in events], values, rtol=1e-6)
        for name, value in point.scalars.items():
            assert reader.Scalars(f"final/{name}")[-1].value == pytest.approx(value, rel=1e-6)
        start = reader.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
        data = hparams.HParamsPluginData.FromString(start)
        found = {key: value.string_value for key, value in data.session_start_info.hparams.items()}
        assert found == point.settings


def stored_records(content):
    """The records of a file of wandb, a log in the format of LevelDB after a header of 7 bytes."""
    place, parts = 7, []
    while place + 7 <= len(content):
        room = 32768 - place % 32768
        if room < 7:  # a block ends with zeros where no header fits
            place += room
            continue
        _, length, kind = struct.unpack("<IHB", content[place : place + 7])
        parts.append(content[place + 7 : place + 7 + length])
        place += 7 + length
        if kind in (1, 4):  # a full record, or the last part of one
            yield b"".join(parts)
            parts = []


@pytest.fixture
def unreachable(monkeypatch):
    """Variables of the environment that name servers which cannot be reached."""
    monkeypatch.setenv("WANDB_MODE", "online")
    monkeypatch.setenv("WANDB_BASE_URL", "http://localhost:9")
    monkeypatch.setenv("WANDB_RUN_ID", "one-for-all")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://localhost:9")


def test_wandb_writes_offline_runs_without_a_network(car, points, tmp_path, unreachable):
    pytest.importorskip("wandb")
    records = pytest.importorskip("wandb.proto.wandb_internal_pb2")
    out = export(car, "wandb", tmp_path / "out")
    found = {}
    for path in out.glob("wandb/offline-run-*/*.wandb"):
        name, config, history, summary = "", {}, [], {}
        for data in stored_records(path.read_bytes()):
            record = records.Record.FromString(data)
            kind = record.WhichOneof("record_type")
            if kind == "run":
                name = record.run.display_name
                config |= {item.key: json.loads(item.value_json) for item in record.run.config.update}
            elif kind == "history":
                items = record.history.item
                history.append({i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in items})
            elif kind == "summary":
                items = record.summary.update
                summary |= {i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in items}
        found[name] = config, history, summary
    assert set(found) == {point.name for point in points}
    for point in points:
        config, history, summary = found[point.name]
        assert point.settings.items() <= config.items()
        each = curve(point, "train/return")
        assert [row["episode"] for row in history] == each.x.tolist()
        assert [row["train/return"] for row in history] == pytest.approx(each.mean.tolist())
        assert summary["final/last_return"] == pytest.approx(point.scalars["last_return"])


def test_mlflow_reads_its_database_written_without_a_network(car, points, tmp_path, unreachable):
    mlflow = pytest.importorskip("mlflow")
    pytest.importorskip("sqlalchemy")
    out = export(car, "mlflow", tmp_path / "out")
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{out.resolve()}/mlflow.db")
    experiment = client.get_experiment_by_name("car").experiment_id
    runs = {run.info.run_name: run for run in client.search_runs([experiment])}
    assert set(runs) == {point.name for point in points}
    for point in points:
        run = runs[point.name]
        assert run.info.status == "FINISHED" and run.data.params == point.settings
        each = curve(point, "train/return")
        history = sorted(client.get_metric_history(run.info.run_id, "train/return"), key=lambda m: m.step)
        assert [metric.step for metric in history] == each.x.tolist()
        assert [metric.value for metric in history] == pytest.approx(each.mean.tolist())
        assert run.data.metrics["final/last_return"] == pytest.approx(point.scalars["last_return"])


MISTAKES = """\
car
=> the following arguments are required: --to
--to csv
=> the following arguments are required: DIR
car --to tensorbord
=> --to: got tensorbord; allowed: csv, mlflow, tensorboard, wandb; did you mean "tensorboard"?
nowhere --to csv
=> nowhere: no such results folder
full --to csv
=> full: not a results folder
newer --to csv
=> newer: this version of bojax cannot read the settings of emu-q
car --to csv --out full
=> full: the folder is not empty; give another --out
car --to csv --out notes.txt
=> notes.txt: is not a folder; allowed: a new or
"""


class TestMistakes:
    @pytest.fixture
    def here(self, here):
        write_learning(here / "car", runs=2, episodes=2, recorded=1)
        write_learning(here / "newer", runs=2, episodes=2, recorded=1)
        edit_manifest(here / "newer", lambda m: m["points"][0]["config"].update(episodes="many"))
        (here / "notes.txt").write_text("precious")
        (here / "full").mkdir()
        (here / "full" / "notes.txt").write_text("precious")
        return here

    def test_a_mistake_is_one_line_and_writes_nothing(self, here, refusal):
        for words, message in cases(MISTAKES):
            assert refusal(f"export {words}").startswith(message)

    def test_a_missing_library_is_named_and_nothing_is_written(self, here, monkeypatch, refusal):
        for target, package in (("tensorboard", "tensorboardX"), ("wandb", "wandb"), ("mlflow", "mlflow")):
            monkeypatch.setitem(sys.modules, package, None)
            told = f"install it in a clone of bojax: pip install -e '.[{target}]'"
            assert refusal(f"export car --to {target}") == f"{package} is not installed; {told}"

    def test_an_error_of_a_library_is_one_line_and_writes_nothing(self, here, monkeypatch, refusal):
        def refuse(**settings):
            raise ValueError("base_url\n  should be a valid URL")

        monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(Settings=refuse))
        reason = "wandb cannot write it (ValueError: base_url should be a valid URL)"
        told = f"car/export/wandb: {reason}; the results are unchanged; try --to csv"
        assert refusal("export car --to wandb", code=1) == told

    def test_a_good_command_names_its_folder_and_does_not_overwrite_it(self, here, capsys, refusal):
        assert main(["export", "car", "--to", "csv"]) == 0
        assert capsys.readouterr().out == "car/export/csv\n"
        assert "car/export/csv: the folder is not empty" in refusal("export car --to csv")
