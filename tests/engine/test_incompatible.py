"""Parts that do not fit each other are refused in one line, before anything is compiled or written."""

import pytest

from bojax.cli.main import main
from bojax.config.errors import ConfigError
from bojax.config.sweep import load_config
from bojax.engine.build import build

KERNEL = "{kind: sum, first: rbf, second: {kind: scaled, kernel: {kind: matern52, lengthscale: [1, 1, 1]}}}"

REFUSED = {
    "a table for numbers": (
        ["mountain-car", "learner=additive"],
        "observation_space: a tabular learner needs",
    ),
    "indicators for numbers": (
        ["mountain-car", "learner.features=indicators"],
        "features: got indicators; allowed only for discrete",
    ),
    "indicators of RFF-Q": (
        ["mountain-car", "learner={kind: rff-q, features: indicators}"],
        "features: got indicators; allowed only for discrete",
    ),
    "lengthscales of a planner": (
        ["parking", "planner.kernel.lengthscale=[1, 1, 1, 1, 1, 1, 1]"],
        "planner.kernel: does not accept points of dimension 3 (the parameters of the motions)",
    ),
    "lengthscales of a single parameter": (
        ["parking", "planner.motions.num_segments=1", "planner.kernel.lengthscale=[1, 2]"],
        "planner.kernel: does not accept points of dimension 1 (the parameters of the motions)",
    ),
    "lengthscales deep inside": (
        ["diagonal", f"problem.kernel={KERNEL}"],
        "problem.kernel: does not accept points of dimension 2 (the coordinates of the plane)",
    ),
    "weights of a mean": (
        ["diagonal", "problem.mean={kind: linear, weights: [1, 2, 3]}"],
        "problem.mean: does not accept points of dimension 2 (the coordinates of the plane)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    (name, *changes), message = REFUSED[case]
    config = load_config(name, changes).points[0].config
    with pytest.raises(ConfigError) as raised:
        build(config, getattr(config, "dtype", "float64"))
    assert message in str(raised.value)


def test_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "mountain-car", "learner=additive", "--out", "out"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "mountain-car.yaml: experiment: observation_space: " in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("parking", "planner.kernel.lengthscale=[0.3, 0.4, 0.5]"),
        ("parking", "planner.kernel.lengthscale=[0.3]"),
        ("diagonal", "problem.kernel={kind: rbf, lengthscale: [0.5, 0.6]}"),
        ("diagonal", "problem.mean={kind: linear, weights: [1, 2]}"),
        ("chain", "learner={kind: rff-q, features: indicators}"),
    ],
)
def test_fitting(name, change):
    config = load_config(name, [change]).points[0].config
    assert build(config, getattr(config, "dtype", "float64"))
