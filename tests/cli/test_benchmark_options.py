"""The command line of benchmarks: what is accepted, and what is refused."""

import importlib
from pathlib import Path

import pytest


@pytest.fixture
def bench_robots(monkeypatch):
    """The benchmark of the robots; nothing of it runs."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("bench_robots")


def test_settings_of_the_solver(bench_robots, capsys):
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
