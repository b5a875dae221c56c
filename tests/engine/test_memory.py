"""Settings whose arrays do not fit into the memory are refused in one line, before anything is written."""

import jax

from bojax.config.limits import budget
from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.engine.memory import check_memory, largest_array
from tests.transcript import cases

REFUSED = """\
parking planner.max_actions=1000000
=> planner.max_actions: got 1000000; an array of one run would take about
parking planner.iterations=20000 planner.num_candidates=20000 planner.max_actions=50000
=> planner.max_actions: got 50000; an array of one run would take about
mountain-car map_episodes=[1] map_resolution=40000
=> map_resolution: got 40000; an array of one run would take about
parking 'planner={kind: gps-abt, max_levels: 9000000}' planner.num_rollout_paths=9000000
=> got 9000000
parking planner.max_actions=10000000000
=> planner.max_actions: got 10,000,000,000 entries or steps, which take about
parking planner.depth=10000000
=> planner.depth: got 10000000; allowed: at most
mountain-car 'learner={kind: rnd, depth: 10000000}'
=> learner.depth: got 10000000; allowed: at most
two-pits problem.resolution=1000000
=> problem.resolution: got 1000000; allowed: at most
lunar-lander 'learner={kind: rff-q, features: {kind: fourier-basis, order: 30}}'
=> learner.features.order: got 819,628,286,980,801 features, which take about
lunar-lander learner.features=fourier-basis
=> learner.features: got 1,099,511,627,776 entries of a covariance, which take about
mountain-car learner.features.num_features=1000000
=> learner.features: got 1,000,000,000,000 entries of a covariance, which take about
"""


def test_too_large_for_the_memory(here, refusal, monkeypatch):
    for module in ("config.limits", "engine.memory"):  # on a machine of 24 GB
        monkeypatch.setattr(f"bojax.{module}.budget", lambda: 12 << 30)
    for words, message in cases(REFUSED):
        assert message in refusal(f"run {words} --runs 1 --out out")


def test_the_largest_array_is_that_of_the_cell_that_is_asked_for():
    config = load_config("mountain-car", ["map_episodes=[1]", "map_resolution=700"]).points[0].config
    size = largest_array(build(config, "float32"))
    assert 700 * 700 * 4 <= size < budget()


def test_an_ordinary_experiment_is_not_traced(monkeypatch):
    config = load_config("parking", ["planner.iterations=3000"]).points[0].config
    monkeypatch.setattr(jax, "make_jaxpr", None)
    check_memory(build(config), config, str)
