"""Parts that do not fit each other are refused in one line, before anything is compiled or written."""

import shlex

import pytest

from bojax.config.errors import ConfigError
from bojax.config.sweep import load_config
from bojax.engine.build import build
from tests.transcript import cases

REFUSED = """\
mountain-car learner=additive
=> observation_space: a tabular learner needs
mountain-car learner.features=indicators
=> features: got indicators; allowed only for discrete
mountain-car 'learner={kind: rff-q, features: indicators}'
=> features: got indicators; allowed only for discrete
parking 'planner.kernel.lengthscale=[1, 1, 1, 1, 1, 1, 1]'
=> planner.kernel: does not accept points of dimension 3 (the parameters of the motions)
parking planner.motions.num_segments=1 'planner.kernel.lengthscale=[1, 2]'
=> planner.kernel: does not accept points of dimension 1 (the parameters of the motions)
diagonal 'problem.kernel={kind: sum, first: rbf, second: {kind: rbf, lengthscale: [1, 1, 1]}}'
=> problem.kernel: does not accept points of dimension 2 (the coordinates of the plane)
diagonal 'problem.mean={kind: linear, weights: [1, 2, 3]}'
=> problem.mean: does not accept points of dimension 2 (the coordinates of the plane)
"""


def test_refused():
    for words, message in cases(REFUSED):
        name, *changes = shlex.split(words)
        config = load_config(name, changes).points[0].config
        with pytest.raises(ConfigError) as raised:
            build(config, getattr(config, "dtype", "float64"))
        assert message in str(raised.value)


def test_nothing_is_written(here, refusal):
    error = refusal("run mountain-car learner=additive --out out")
    assert "mountain-car.yaml: experiment: observation_space: " in error


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
