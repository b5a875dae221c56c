"""Every planner and every problem: two paths are planned, driven and learned from."""

import pytest

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.experiments.settings import Planning
from bojax.planning.settings import BeliefPlannerSettings, RouteSettings
from bojax.problems.pomdp.settings import StateProblemSettings
from tests.parts import tiny
from tests.protocol.lanes import each_kind, of_experiment

pytestmark = pytest.mark.usefixtures("data_files")

# No curve of these paths is tighter than a robot can drive.
PATHS = {"kind": "kernel", "first_angle": 0.785, "turn_angle": 1.257, "num_samples": 3}

STATE_PROBLEMS = [
    kind for kind, schema in kinds("problem").items() if issubclass(schema, StateProblemSettings)
]


# Compared with plain NumPy, and run in lanes, in tests/planning.
@each_kind("planner", traced=["gps-abt", "kcbts", "sbo", "pft-dpw", "pomcpow"])
def test_a_planner_plans(kind, check):
    if kind == "policy":
        pytest.skip("it predicts no value; run in tests/experiments/test_belief_planning.py")
    schema = tiny("planner", kind)
    # A planner with an objective of its own needs a field, as does one that counts its steps.
    needs_field = getattr(schema, "objective", None) is not None or isinstance(schema, RouteSettings)
    problem = "space-modelling" if needs_field else "parking"
    if isinstance(schema, BeliefPlannerSettings):
        problem = "light-dark"
    settings = {"problem": tiny("problem", problem).model_dump(), "planner": schema.model_dump()}
    episode = build(Planning.model_validate(settings))
    check(episode.planner, of_experiment(lambda episode: episode.planner, scores), episode)


# Run in tests/problems, in lanes, and compared there with what they are made of.
@each_kind("problem", traced=["hilly-terrain", "indoor-props", "monitoring", *STATE_PROBLEMS])
def test_a_problem_is_planned_on(kind, check):
    problem = tiny("problem", kind)
    planner = {"kind": "random", "motions": PATHS}
    if isinstance(problem, StateProblemSettings):
        planner = tiny("planner", "pomcpow").model_dump()
    settings = {"problem": problem.model_dump(), "planner": planner}
    episode = build(Planning.model_validate(settings))
    check(episode.problem, of_experiment(lambda episode: episode.problem, scores), episode)


def scores(episode, carry):
    # Null where the coarse grid of the tiny map has no point: at the edges of props, or between them.
    nullable = {column.name for column in episode.tables["runs"] if column.nullable}
    return {name: score for name, score in episode.summary(carry).items() if name not in nullable}
