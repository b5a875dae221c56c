"""Figures are found by their names."""

import numpy as np
import pytest

from bojax.config.errors import ConfigError
from bojax.config.figures import FIGURES
from bojax.config.sweep import load_sweep
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.figures import draw
from tests.report.synthetic import in_memory


@pytest.mark.parametrize("episodes", [None, {"a": np.zeros((3, 2))}])
@pytest.mark.parametrize("name", FIGURES)
def test_results_that_lack_its_columns_do_not_allow_a_figure(name, episodes):
    results = in_memory({"a": {"other": np.zeros(3)}}, episodes=episodes)
    with pytest.raises(FigureUnavailable):
        draw(name, results)


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
