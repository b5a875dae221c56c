"""The models over which a planned survey is averaged."""

import jax
import numpy as np
import pytest

from bojax.areas.area import Area
from bojax.surveys import planning
from bojax.surveys.model import assumed_model
from bojax.surveys.planning import Demand, plan_survey
from bojax.surveys.route import Route


@pytest.mark.parametrize(
    ("budget", "robots", "longest"),
    [(200.0, 1, 1.4), (50.0, 1, 2.0), (25.0, 2, 2.0), (20.0, 1, 3.0)],
)
def test_longer_lengthscales_count_where_lines_would_be_far_apart(monkeypatch, budget, robots, longest):
    seen = []

    def plan_nothing(*arguments, options, **others):
        seen.append(options.stretch)
        (name, routes), *_ = arguments[5].items()
        return [Route(route, 0.0, 0.0, name, {}) for route in routes]

    monkeypatch.setattr(planning, "plan_routes", plan_nothing)
    with jax.enable_x64(True):
        square = Area.rectangle(0.0, 0.0, 10.0, 10.0)
        plan_survey(square, assumed_model(10.0, 1.0), Demand(budget, np.array([0.0, 0.0]), robots=robots))
    assert seen == [(0.7, pytest.approx(longest))]
