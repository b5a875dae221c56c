"""Damaged and edited results folders end in one line that names the file."""

import os
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import bojax
from bojax.cli.main import main
from bojax.report.build import build_report
from bojax.results.store import ResultsError, fingerprint
from tests.report.synthetic import edit_manifest, write_monitoring, write_results


def refusal(folder):
    with pytest.raises(ResultsError) as error:
        build_report(folder)
    assert not (folder / "report.html").exists() and not (folder / "claims.json").exists()
    message = str(error.value)
    assert "\n" not in message and len(message) - len(str(folder)) < 250 and error.value.exit_code == 2
    return message


def sealed(folder):
    """Record the checksums of the tables and snapshots in the manifest, as merging does."""
    files = [*folder.glob("*.parquet"), *folder.glob("arrays/*.npz")]
    found = {path.relative_to(folder).as_posix(): fingerprint(path)["sha256"] for path in files}
    edit_manifest(folder, lambda manifest: manifest.update(sha256=found))
    return folder


def edited(change):
    """Damage of a table that leaves a well-formed file."""

    def edit(path):
        pq.write_table(change(pq.read_table(path)), path)

    return edit


def content(change):
    """Damage of the bytes of a file."""
    return lambda path: path.write_bytes(change(bytearray(path.read_bytes())))


def flipped(content):
    content[len(content) // 2] ^= 1
    return content


def as_pipe(path):
    path.unlink()
    os.mkfifo(path)


DAMAGES = {
    "flipped byte": content(flipped),
    "truncated": content(lambda content: content[:-40]),
    "empty": content(lambda content: b""),
    "bytes appended": content(lambda content: content + b"x"),
    "text": content(lambda content: b"point,run\n0,0\n"),
    "of another sweep": lambda path: shutil.copyfile(path.parents[1] / "other" / path.name, path),
    "column dropped": edited(lambda table: table.drop_columns(table.column_names[-1])),
    "column of another type": edited(
        lambda table: table.set_column(0, "point", table["point"].cast(pa.string()))
    ),
    "rows lost": edited(lambda table: table.slice(1)),
    "rows twice": edited(lambda table: pa.concat_tables([table, table])),
    "rows in another order": edited(lambda table: table.take(np.arange(table.num_rows)[::-1])),
    "one value edited": edited(lambda table: table.set_column(2, "x", pa.array(np.ones(table.num_rows)))),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a pipe": as_pipe,
}


def test_damaged_tables_are_refused_by_every_command_that_reads_them(tmp_path, refusal):
    write_results(tmp_path / "other", runs=3, recorded=0)
    whole = sealed(write_results(tmp_path / "whole", runs=2, recorded=0))
    for number, (name, damage) in enumerate(DAMAGES.items()):
        for table in ("runs", "steps"):
            folder = tmp_path / f"{number}-{table}"
            shutil.copytree(whole, folder)
            damage(folder / f"{table}.parquet")
            before = {path.name for path in folder.iterdir()}
            for command in ("report", "export --to csv", "compare", "best"):
                assert refusal(f"{command} {folder}").startswith(f"{folder / table}.parquet: "), name
            with pytest.raises(bojax.BojaxError, match=rf"{table}\.parquet: "):
                bojax.load(folder)
            assert {path.name for path in folder.iterdir()} == before


def test_tables_as_they_were_merged_are_read_and_a_large_one_may_be_deleted(tmp_path):
    folder = sealed(write_results(tmp_path / "results", runs=2, recorded=0))
    assert bojax.load(folder).runs.num_rows == 10
    (folder / "steps.parquet").unlink()
    build_report(folder)


def test_damage_that_parquet_notices_is_refused_without_checksums_in_the_manifest(tmp_path):
    """As in results of earlier versions."""
    for name in ("truncated", "empty", "text"):
        folder = write_results(tmp_path / name, runs=2, recorded=0)
        DAMAGES[name](folder / "runs.parquet")
        assert "runs.parquet: not a readable parquet file" in refusal(folder)


def test_results_without_a_return_are_one_line(tmp_path, refusal):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    edited(lambda table: table.drop_columns("return"))(folder / "runs.parquet")
    assert "unknown column return" in refusal(f"best {folder}")


def test_results_whose_runs_have_all_failed_are_one_line(tmp_path, refusal):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    edit_manifest(folder, lambda manifest: manifest.update(status="failed"))
    (folder / "runs.parquet").unlink()
    assert f"{folder}: all runs failed: bojax status {folder} says why" in refusal(f"report {folder}")


MANIFESTS = (
    (lambda m: m.update(points=5), "points: got 5; allowed: a list"),
    (lambda m: m.pop("points"), "points: missing or empty"),
    (lambda m: m["points"][1].update(index="1"), 'points[1].index: got "1"; allowed: an integer'),
    (lambda m: m["points"][1].update(index=True), "points[1].index: got true"),
    (lambda m: m["points"][1].update(index=0), "points: two have the index 0"),
    (lambda m: m["points"][1].update(label=None), "points[1].label: got null; allowed: text"),
    (lambda m: m["points"][1].update(swept=[1]), "points[1].swept: got [1]; allowed: a mapping"),
    (lambda m: m["points"][0].update(outline={"goals": [[1.0]]}), "goals: got [1.0]; allowed: 3 or 4 finite"),
    (lambda m: m.update(status=["finished"]), "status"),
    (lambda m: m.update(status="running"), "--resume"),
    (lambda m: m.update(runs=-1), "runs: got -1; allowed: >= 0"),
    (lambda m: m.update(changed={"runs": 3}), "changed.runs: got 3; allowed: a list"),
    (lambda m: m.update(report=[]), "report: got []; allowed: a mapping"),
    (lambda m: m.update(report={"rolling": 0}), "report.rolling: got 0; allowed: >= 1"),
    (lambda m: m.update(claims=["order"]), 'claims[0]: got "order"; allowed: a mapping'),
    (lambda m: m["claims"][2].update(test=[]), "claims[2].test: got []; allowed: a mapping"),
    (lambda m: m["groups"][0].update(run_seconds="2 s"), "groups[0].run_seconds: got"),
    (lambda m: m.update(chunks=[{"error": 5}]), "chunks[0].error: got 5; allowed: text"),
    (lambda m: m.update(versions="1.0"), "versions: got"),
)


def test_manifests_of_other_types_are_refused(tmp_path):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    path = folder / "manifest.json"
    whole = path.read_text()
    for edit, told in MANIFESTS:
        path.write_text(whole)
        edit_manifest(folder, edit)
        message = refusal(folder)
        assert str(folder) in message and told in message
    for content in ("[]", whole[: len(whole) // 2]):
        path.write_text(content)
        assert str(path) in refusal(folder)
    path.unlink()
    assert "no manifest.json" in refusal(folder)


def test_half_a_surrogate_pair_is_a_mark_on_the_page(tmp_path):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    edit_manifest(folder, lambda m: m["points"][0]["config"]["problem"].update(kind="\ud800"))
    edit_manifest(folder, lambda m: m.update(title="half \udc00"))
    assert main(["report", str(folder)]) == 0
    assert "half ?" in (folder / "report.html").read_text()


def test_latencies_that_are_damaged_or_of_other_settings_are_refused(tmp_path):
    folder = write_results(tmp_path / "results", runs=2, recorded=0)
    for content, told in {
        '{"seconds": {"0": [1.0]}}': "seconds.0: got [1.0]",
        '{"config_hash": "other"}': "measured for other settings than those of this folder",
        '{"seconds": ': "was it truncated?",
    }.items():
        (folder / "latency.json").write_text(content)
        message = refusal(folder)
        assert str(folder / "latency.json") in message and told in message


def test_damaged_snapshots_are_refused(tmp_path, capsys):
    folder = sealed(write_monitoring(tmp_path / "results", runs=2, recorded=1))
    path = folder / "arrays" / "0-0-paths-end.npz"
    with np.load(path) as arrays:
        changed = {name: array + 1 for name, array in arrays.items()}
    np.savez(path, **changed)
    for command in ("report", "render"):
        assert main([command, str(folder)]) == 2
        *_, line = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {path}: damaged or edited")
    assert not (folder / "report.html").exists() and not (folder / "animations").exists()


def test_snapshots_of_a_problem_of_ones_own_are_left_alone(tmp_path):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=1)
    edit_manifest(folder, lambda manifest: manifest.update(report={"figures": ["paths", "beliefs"]}))
    np.savez(folder / "arrays" / "0-0-belief-end.npz", mean=np.zeros(3), weights=np.zeros((2, 2)))
    build_report(folder)
    assert (folder / "figures" / "paths.png").exists()


def test_a_setting_that_cannot_be_drawn_is_one_line_of_render(tmp_path, refusal):
    folder = write_monitoring(tmp_path / "results", runs=2, recorded=1)
    edit_manifest(folder, lambda m: [p["config"]["problem"].update(domain="wide") for p in m["points"]])
    message = f"{folder}: this version cannot read the settings: problem.domain: got"
    assert refusal(f"render {folder}").startswith(message)
