"""Sizes that exceed the memory are refused in one line, with the memory that they would take."""

import json
import random
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from bojax.config.errors import ConfigError
from bojax.config.launching import SlurmConfig, load_launching
from bojax.config.limits import Limit, counts_of
from bojax.config.sweep import load_config, load_sweep
from bojax.config.yaml_file import parse, read_mapping
from bojax.fields.data import read_array
from bojax.report.comparing.curve_files import read_curves
from bojax.robots.models import from_file
from tests.drawn import drawn_experiment


def refusal(load, *words, **options) -> str:
    """The message of a refused sweep."""
    with pytest.raises(ConfigError) as raised:
        load(*words, **options)
    return str(raised.value)


def test_more_memory_allows_more():
    small, large = (Limit("things", bytes_each, at_least=10) for bytes_each in (2**60, 1))
    assert small.allowed == 10 and large.allowed > 2**27
    with pytest.raises(ConfigError) as raised:
        small.check(11, "x.yaml: things")
    assert str(raised.value) == (
        "x.yaml: things: got 11 things, which take about 11 EiB of memory; allowed: at most 10"
    )
    small.check(10, "x.yaml: things")


def test_integers_of_all_schemas_have_a_limit(data_files, write):
    settings = set()
    for seed in range(60):
        experiment = drawn_experiment(random.Random(seed))
        for path, _, _ in counts_of(experiment):
            part = reduce(getattr, path[:-1], experiment)
            if (part.kind, path[-1]) in settings or isinstance(getattr(part, path[-1]), tuple):
                continue
            if path[-1] == "relearn_every" and part.noise_variance == 0.0:
                continue  # refused whatever the number is: relearning needs noise
            settings.add((part.kind, path[-1]))
            tree = experiment.model_dump(mode="json")
            reduce(dict.__getitem__, path[:-1], tree)[path[-1]] = 10**10
            write("x.yaml", json.dumps({"experiment": tree.pop("kind"), **tree}))
            message = refusal(load_config, "x.yaml")
            assert path[-1] in message and ("10,000,000,000" in message or "10000000000" in message)
    assert len(settings) > 60


def test_a_file_without_an_end_is_refused(monkeypatch):
    text = Limit("bytes of text", 2**60, at_least=1000)
    for name in ("report.comparing.curve_files", "robots.models"):
        monkeypatch.setattr(f"bojax.{name}.TEXT", text)
    for read in (
        read_curves,
        from_file,
        lambda path: read_mapping(path, str(path)),
        lambda path: load_launching(path, SlurmConfig),
    ):
        with pytest.raises(ConfigError, match=r"^/dev/zero: (got 1,001 bytes|has more than 4 MiB).*allowed"):
            read(Path("/dev/zero"))


def test_a_table_with_more_numbers_than_fit(tmp_path, monkeypatch):
    monkeypatch.setattr("bojax.fields.data.NUMBERS", Limit("numbers", 2**60, at_least=10))
    np.save(tmp_path / "a.npy", np.zeros((4, 3), np.int8))
    with pytest.raises(ValueError, match=r"a\.npy: got 12 numbers, which take about .*at most 10"):
        read_array(str(tmp_path / "a.npy"))


def test_runs(write):
    for runs in (10**9, 10**12):
        message = refusal(load_config, "parking", runs=runs)
        assert message.startswith(f"command line: runs: got {runs:,} runs in total, which take about ")
        assert refusal(load_config, "parking", [f"runs={runs}"]) == message
    write("s.yaml", "{base: {}, runs: 2000000000, axes: {planner.depth: [1, 2, 3]}}")
    assert refusal(load_sweep, "s.yaml").startswith("s.yaml: runs: got 6,000,000,000 runs in total")


def test_a_grid(write):
    values = list(range(1, 1001))
    axes = ", ".join(f"problem.{name}: {values}" for name in ("half_width", "max_steps", "success_reward"))
    write("s.yaml", f"{{base: {{}}, axes: {{{axes}}}}}")
    assert refusal(load_sweep, "s.yaml").startswith("s.yaml: axes: got 1,000,000,000 points, which take ")


def test_an_axis(write, monkeypatch):
    monkeypatch.setattr("bojax.config.axes.POINTS", Limit("points", 2**60, at_least=20))
    for combine in ("grid", "zip"):
        sweep = f"{{base: {{}}, combine: {combine}, axes: {{problem.half_width: VALUES}}}}"
        write("s.yaml", sweep.replace("VALUES", str([*range(1, 21)])))
        assert len(load_sweep("s.yaml").points) == 20
        write("s.yaml", sweep.replace("VALUES", str([*range(1, 22)])))
        assert refusal(load_sweep, "s.yaml").startswith("s.yaml: axes.problem.half_width: got 21 points")


def test_equal_values_of_any_type_are_found(write):
    for values, which in (
        ("[[1, 2], [1.0, 2]]", "got [1, 2] and [1.0, 2]"),
        ("[rbf, rbf]", 'got "rbf" and "rbf"'),
        ("[2, 1, 1.0]", "got 1 and 1.0"),
        ("[1e0, 0x1]", "got 1.0 and 1"),
        ("[1, true]", "got 1 and true"),
        ("[[{a: 1}], [{a: 1.0}]]", 'got [{"a": 1}] and [{"a": 1.0}]'),
    ):
        write("s.yaml", f"{{base: {{}}, axes: {{planner.kernel.lengthscale: {values}}}}}")
        assert f"{which}, which are equal; allowed: distinct values" in refusal(load_sweep, "s.yaml")
        ones = [1] * len(parse(values, "s.yaml"))
        axes = f"{{planner.kernel.lengthscale: {values}, problem.half_width: {ones}}}"
        write("s.yaml", f"{{base: {{}}, combine: zip, axes: {axes}}}")
        assert "are equal; allowed in a zip: distinct points" in refusal(load_sweep, "s.yaml")


def test_only_the_first_unknown_key_is_described(write):
    write("x.yaml", "problem: {" + ", ".join(f"k{index}: 1" for index in range(500)) + "}")
    message = refusal(load_config, "x.yaml")
    assert message.startswith("x.yaml: problem.k0: unknown key; allowed: ")
    assert message.endswith(" (and 499 more errors)")
