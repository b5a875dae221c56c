"""Benchmarks: measurements of chunks, the comparison of tables, and what command lines accept."""

import importlib
import json
import threading
import time
from pathlib import Path

import pytest

CHUNKS = ("chunk-00000-0123456789ab", "chunk-00001-ba9876543210")


@pytest.fixture
def imported(monkeypatch):
    """Imports a benchmark, of which nothing runs."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module


@pytest.fixture
def bench(imported):
    """The benchmark of scaling."""
    return imported("bench_scaling")


def row(devices, seconds, *, launcher="inline", runs=64, sha256="a"):
    """A measurement of parking on some GPUs."""
    hashes = [{"runs.parquet": sha256}]
    row = {"sweep": "parking", "runs": runs, "device": "card", "devices": devices, "launcher": launcher}
    return row | {
        "command_seconds": seconds + 5,
        "chunk_seconds": seconds,
        "advancing_seconds": 8.0,
        "sha256": hashes,
    }


def test_chunks_are_timed_while_they_run(bench, tmp_path):
    work = tmp_path / "sweep" / ".work"

    def run():
        for chunk in CHUNKS:
            (work / f"{chunk}-1").mkdir(parents=True)
            (work / f"{chunk}-1" / "attempt.json").write_text("{}")
            time.sleep(0.3)
            (work / f"{chunk}-1.done").write_text("{}")
        time.sleep(0.2)
        for chunk in CHUNKS:  # merging
            (work / f"{chunk}-1.done").unlink()

    with bench.ChunkWatch(tmp_path) as watch:
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
    first, second = watch.spans()
    assert first == pytest.approx((0, 0.3), abs=0.1)
    assert second == pytest.approx((0.3, 0.6), abs=0.15)


def test_a_chunk_merged_between_two_looks_has_ended(bench, tmp_path):
    attempt = tmp_path / ".work" / f"{CHUNKS[0]}-1"
    attempt.mkdir(parents=True)
    (attempt / "attempt.json").write_text("{}")
    with bench.ChunkWatch(tmp_path) as watch:
        time.sleep(0.3)
        (attempt / "attempt.json").unlink()
        attempt.rmdir()
        time.sleep(0.2)
    assert [end > 0.25 for _, end in watch.spans()] == [True]


def test_speed_up_and_tables(bench, tmp_path, capsys):
    rows = [row(1, 8.0), row(2, 4.0), row(2, 5.0, launcher="ray"), row(2, 3.0, runs=256)]
    assert [bench.speed_up(rows, each) for each in rows] == [1, 2, 1.6, None]
    file = tmp_path / "rows.json"
    file.write_text(json.dumps({"rows": rows}))
    assert bench.main(["--results", str(file), "--plot", str(tmp_path / "figure.png")]) == 0
    assert "| parking | 64 | 2 | ray | 5.0 | 10.0 | 1.60 | 8.0 |" in capsys.readouterr().out
    assert (tmp_path / "figure.png").stat().st_size > 1000
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"rows": [row(2, 4.0, sha256="b")]}))
    assert bench.main(["--results", str(file), str(other)]) == 1
    assert "error: parking, 64 runs, card: tables differ between measurements" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--divide 7", "--divide: got 7; allowed: divisors of 4000"),
        ("--runs 5000", "--runs: got 5000; allowed: multiples of 4000"),
        ("--device cpu", "--device cpu: name the numbers of parts with --devices"),
        ("--devices 0", "got 0; allowed: >= 1"),
        ("--first -1", "--first: got -1; allowed: the index of a GPU, from 0"),
    ],
)
def test_refused_arguments(bench, words, line, capsys):
    with pytest.raises(SystemExit) as exit_info:
        bench.parse(words.split())
    assert exit_info.value.code == 2
    assert line in capsys.readouterr().err


def test_gpus_of_a_command(bench, tmp_path):
    assert bench.place_on(2, "inline", tmp_path, 2) == ["--devices", "2,3"]


def test_numbers_of_devices(bench):
    assert [bench.powers(count) for count in (1, 2, 3, 4, 8)] == [
        [1],
        [1, 2],
        [1, 2, 3],
        [1, 2, 4],
        [1, 2, 4, 8],
    ]


def test_devices_of_the_machine(bench, monkeypatch, capsys):
    def chosen(count, *words):
        monkeypatch.setattr(bench, "count_gpus", lambda: count)
        args = bench.parse(words)
        bench.choose_devices(args)
        assert ("space-modelling" in args.only) == (args.divide == 1)
        return args.device, args.devices, args.divide

    assert chosen(4) == ("gpu", [1, 2, 4], 1)
    assert chosen(4, "--devices", "2", "3") == ("gpu", [2, 3], 1)
    assert chosen(0) == ("cpu", [1, 2], 1000)
    assert "no GPU" in capsys.readouterr().out
    assert chosen(4, "--device", "cpu", "--devices", "2") == ("cpu", [2], 1)
    with pytest.raises(SystemExit, match="--devices: got 8; allowed: 1 to 4, the GPUs from --first on"):
        chosen(4, "--devices", "8")
    assert chosen(4, "--first", "3", "--devices", "1") == ("gpu", [1], 1)
    with pytest.raises(SystemExit, match="--devices: got 2; allowed: 1 to 1"):
        chosen(4, "--first", "3", "--devices", "2")
    with pytest.raises(SystemExit, match="JAX finds no GPU"):
        chosen(0, "--devices", "1")


def test_settings_of_the_solver(imported, capsys):
    bench_robots = imported("bench_robots")
    given = ["model", "4/8/rk4", "3/6/Euler", "10/5/ImplicitFast"]
    expected = ["model", "4/8/rk4", "3/6/euler", "10/5/implicitfast"]
    assert bench_robots.parse(["--settings", *given]).settings == expected
    assert bench_robots.parse([]).settings == ["model"]
    for setting in ("3/6", "3/6/rk5", "0/6/rk4", "a/6/rk4", "3/6/rk4/1", "default", ""):
        with pytest.raises(SystemExit) as exit_info:
            bench_robots.parse(["--settings", setting])
        assert exit_info.value.code == 2
        line = capsys.readouterr().err.splitlines()[-1]
        assert f"--settings: got {setting}; allowed: model or I/L/INTEGRATOR, such as 4/8/rk4" in line
