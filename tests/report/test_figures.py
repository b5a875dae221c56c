"""A figure is one file, found by its name."""

import importlib

import numpy as np
import pytest

from bojax.config.errors import ConfigError
from bojax.config.figures import figure_modules
from bojax.config.sweep import load_sweep
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.figures import draw, ranked
from tests.report.synthetic import in_memory


@pytest.mark.parametrize("episodes", [None, {"a": np.zeros((3, 2))}])
@pytest.mark.parametrize("name", figure_modules())
def test_results_that_lack_its_columns_do_not_allow_a_figure(name, episodes):
    results = in_memory({"a": {"other": np.zeros(3)}}, episodes=episodes)
    with pytest.raises(FigureUnavailable):
        draw(name, results)


def test_a_name_is_that_of_the_file():
    assert figure_modules()["steps-to-goal"] == "bojax.report.figures.steps_to_goal"
    assert figure_modules()["settings"] == "bojax.report.figures.settings_"


def test_no_two_figures_have_the_same_place():
    names = ranked()
    assert sorted(names) == list(figure_modules()) and names[0] == "accumulated-reward"
    assert len({importlib.import_module(figure_modules()[name]).RANK for name in names}) == len(names)


def test_a_sweep_may_list_figures_and_the_table_of_latencies(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("{base: parking, report: {figures: [settings, latency, solved-episodes]}}")
    assert load_sweep(str(file)).report["figures"] == ["settings", "latency", "solved-episodes"]


def test_an_unknown_figure_is_refused_before_the_run(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("{base: parking, report: {figures: [paths, steps_to_goal]}}")
    with pytest.raises(ConfigError) as error:
        load_sweep(str(file))
    message = str(error.value)
    assert 'mine.yaml: report.figures: got "steps_to_goal"; allowed: accumulated-reward, ' in message
    assert message.endswith('did you mean "steps-to-goal"?') and "\n" not in message
