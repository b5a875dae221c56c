"""Damaged and edited results folders end in one line that names the file and the key."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bojax.cli.main import main
from bojax.report.build import build_report
from bojax.results.store import ResultsError
from tests.report.synthetic import edit_manifest, write_learning, write_monitoring, write_results

pytestmark = pytest.mark.usefixtures("undrawn")


def refusal(folder):
    with pytest.raises(ResultsError) as error:
        build_report(folder)
    assert not (folder / "report.html").exists() and not (folder / "claims.json").exists()
    message = str(error.value)
    assert "\n" not in message and len(message) - len(str(folder)) < 250 and error.value.exit_code == 2
    return message


def column(name, make):
    """An edit of a table that replaces a column."""

    def edit(table):
        return table.set_column(table.column_names.index(name), name, make(table[name].to_pylist()))

    return edit


def rows(select):
    return lambda table: table.take(select(np.arange(table.num_rows)))


TABLES = [
    (
        "runs",
        column("point", lambda p: pa.array([str(v) for v in p])),
        "runs.parquet: point: got a column of",
    ),
    ("runs", column("point", lambda p: pa.array([None, *p[1:]])), "runs.parquet: point: got 1 nulls"),
    ("runs", column("point", lambda p: pa.array([float(v) for v in p])), "allowed: integers"),
    ("runs", column("point", lambda p: pa.array([*p[:-1], 99])), "point: got 99"),
    ("runs", column("run", lambda p: pa.array([[v] for v in p])), "runs.parquet: run: got a column of list"),
    ("runs", column("run", lambda p: pa.array([-1, *p[1:]])), "runs.parquet: run: allowed: 0 to"),
    ("runs", column("return", lambda p: pa.array([str(v) for v in p])), "return: got a column of string"),
    ("runs", column("success", lambda p: pa.array([int(v) for v in p])), "success: got a column of int64"),
    ("runs", column("success", lambda p: pa.array([None, *p[1:]])), "success: got 1 nulls"),
    ("runs", rows(lambda i: np.repeat(i, 2)), "two rows for point 0, run 0"),
    ("runs", rows(lambda i: i[1:]), "steps.parquet: run: point 0 has no run 0"),
    ("runs", lambda table: table.drop_columns("run"), "runs.parquet: no column run"),
    ("steps", column("step", lambda p: pa.array([None, *p[1:]])), "steps.parquet: step: got 1 nulls"),
    ("steps", column("step", lambda p: pa.array([*p[:-1], 10**12])), "step: got 1000000000000"),
    ("steps", rows(lambda i: np.delete(i, 1)), "step: got 3 of point 0, run 0, where 2 is expected"),
    ("steps", column("accumulated_reward", lambda p: pa.array([str(v) for v in p])), "accumulated_reward"),
]


@pytest.mark.parametrize(("name", "edit", "told"), TABLES, ids=[told for _, _, told in TABLES])
def test_edited_tables_are_refused(tmp_path, name, edit, told):
    folder = write_results(tmp_path / "results", runs=2)
    path = folder / f"{name}.parquet"
    pq.write_table(edit(pq.read_table(path)), path)
    assert told in refusal(folder)


EPISODES = [
    (column("phase", lambda p: pa.array([1] * len(p))), "episodes.parquet: phase: got a column of int64"),
    (column("phase", lambda p: pa.array(["trial", *p[1:]])), "phase: allowed: train, test"),
    (column("episode", lambda p: pa.array([*p[:-1], 10**9])), "episode: allowed in a test: 1 to 3"),
    (rows(lambda i: i[3:]), "episode: got 2 of point 0, run 0, where 1 is expected"),
    (column("length", lambda p: pa.array([bytes(v) for v in p])), "length: got a column of binary"),
]


@pytest.mark.parametrize(("edit", "told"), EPISODES, ids=[told for _, told in EPISODES])
def test_edited_episodes_are_refused(tmp_path, edit, told):
    folder = write_learning(tmp_path / "results", runs=2, episodes=3)
    path = folder / "episodes.parquet"
    pq.write_table(edit(pq.read_table(path)), path)
    assert told in refusal(folder)


MANIFESTS = [
    (lambda m: m.update(points=5), "points: got 5; allowed: a list"),
    (lambda m: m["points"][1].update(index="1"), 'points[1].index: got "1"; allowed: an integer'),
    (lambda m: m["points"][1].update(index=True), "points[1].index: got true"),
    (lambda m: m["points"][1].update(index=0), "points: two have the index 0"),
    (lambda m: m["points"][1].update(label=None), "points[1].label: got null; allowed: text"),
    (lambda m: m["points"][1].update(swept=[1]), "points[1].swept: got [1]; allowed: a mapping"),
    (lambda m: m["points"][1].update(config=3), "points[1].config: got 3; allowed: a mapping"),
    (lambda m: m.update(status=["finished"]), "status"),
    (lambda m: m.update(title=7), "title: got 7; allowed: text"),
    (lambda m: m.update(runs="many"), 'runs: got "many"; allowed: an integer'),
    (lambda m: m.update(runs=-1), "runs: got -1; allowed: >= 0"),
    (lambda m: m.update(seed=0.5), "seed: got 0.5; allowed: an integer"),
    (lambda m: m.update(changed={"runs": 3}), "changed.runs: got 3; allowed: a list"),
    (lambda m: m.update(report=[]), "report: got []; allowed: a mapping"),
    (lambda m: m.update(report={"figures": "returns"}), "report.figures: got"),
    (lambda m: m.update(report={"notes": {}}), "report.notes: got {}; allowed: text"),
    (lambda m: m.update(report={"thesis": 3}), "report.thesis: got 3; allowed: a mapping"),
    (lambda m: m.update(report={"rolling": 0}), "report.rolling: got 0; allowed: >= 1"),
    (lambda m: m.update(report={"by_step": "6"}), "report.by_step: got"),
    (lambda m: m.update(claims={}), "claims: got {}; allowed: a list"),
    (lambda m: m.update(claims=["order"]), 'claims[0]: got "order"; allowed: a mapping'),
    (lambda m: m["claims"][2].update(test=[]), "claims[2].test: got []; allowed: a mapping"),
    (lambda m: m.update(groups=[3]), "groups[0]: got 3; allowed: a mapping"),
    (lambda m: m["groups"][0].update(run_seconds="2 s"), "groups[0].run_seconds: got"),
    (lambda m: m["groups"][0].update(latency_seconds=[1.0]), "groups[0].latency_seconds: got [1.0]"),
    (lambda m: m.update(chunks=[{"error": 5}]), "chunks[0].error: got 5; allowed: text"),
    (lambda m: m.update(versions="1.0"), "versions: got"),
    (lambda m: m.update(git=["97d835b"]), "git: got"),
    (lambda m: m.update(command=["bojax"]), "command: got"),
    (
        lambda m: m["points"][0]["config"].update(deep=json.loads("[" * 200 + "]" * 200)),
        "nested more than 100",
    ),
]


@pytest.mark.parametrize(("edit", "told"), MANIFESTS, ids=[told for _, told in MANIFESTS])
def test_manifests_of_other_types_are_refused(tmp_path, edit, told):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    edit_manifest(folder, edit)
    message = refusal(folder)
    assert str(folder / "manifest.json") in message and told in message


def test_a_manifest_that_is_a_list_is_refused(tmp_path):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    (folder / "manifest.json").write_text("[]")
    assert str(folder / "manifest.json") in refusal(folder)


SNAPSHOTS = [
    (
        "paths",
        {"paths": np.zeros((15, 12))},
        "0-0-paths-end.npz: paths: got the shape [15, 12]; allowed: [T, S, 3]",
    ),
    ("paths", {"paths": np.full((15, 12, 3), "x")}, "paths: got values of type <U1; allowed: numbers"),
    ("paths", {"paths": np.zeros((15, 12, 3), complex)}, "paths: got values of type complex128"),
    (
        "paths",
        {"paths": np.zeros((15, 12, 3)), "start": np.zeros(2)},
        "start: got the shape [2]; allowed: [3]",
    ),
    ("paths", {"paths": np.zeros((15, 12, 3)), "plans": np.zeros((4, 12, 3))}, "allowed: [15, 12, 3]"),
    ("paths", {"poses": np.zeros(3)}, "no array paths"),
    (
        "belief",
        {name: np.zeros(9) for name in ("x", "y", "truth", "mean", "std")},
        "truth: got the shape [9]",
    ),
    (
        "belief",
        {"x": np.zeros(4), "y": np.zeros(3)} | {n: np.zeros((4, 3)) for n in ("truth", "mean", "std")},
        "truth",
    ),
]


@pytest.mark.parametrize(("name", "arrays", "told"), SNAPSHOTS, ids=range(len(SNAPSHOTS)))
@pytest.mark.parametrize("command", ["report", "render"])
def test_snapshots_of_other_shapes_are_refused(tmp_path, capsys, command, name, arrays, told):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=1)
    np.savez(folder / "arrays" / f"0-0-{name}-end.npz", **arrays)
    assert main([command, str(folder)]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {folder}/arrays/0-0-{name}-end.npz: ") and told in line
    assert not (folder / "report.html").exists() and not (folder / "animations").exists()


def test_snapshots_of_a_problem_of_ones_own_are_left_alone(tmp_path):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=1)
    edit_manifest(folder, lambda manifest: manifest.update(report={"figures": ["paths", "beliefs"]}))
    np.savez(folder / "arrays" / "0-0-belief-end.npz", mean=np.zeros(3), weights=np.zeros((2, 2)))
    build_report(folder)
    assert (folder / "figures" / "paths.png").exists()


def test_a_setting_that_cannot_be_drawn_is_one_line_of_render(tmp_path, capsys):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=1)
    edit_manifest(folder, lambda m: [p["config"]["problem"].update(domain="wide") for p in m["points"]])
    assert main(["render", str(folder)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {folder}: this version cannot read the settings: problem.domain: got")


def test_rows_in_another_order_give_the_same_report(tmp_path):
    folders = [
        write_results(tmp_path / name, runs=20, recorded=0, report={"figures": ["returns"]})
        for name in ("as-written", "shuffled")
    ]
    for name in ("runs", "steps"):
        path = folders[1] / f"{name}.parquet"
        table = pq.read_table(path)
        pq.write_table(table.take(np.random.default_rng(0).permutation(table.num_rows)), path)
    for folder in folders:
        build_report(folder)
    first, second = ((folder / "claims.json").read_bytes() for folder in folders)
    assert first == second
