"""Every planner and every problem: two paths are planned, driven and learned from."""

from bojax.engine.build import build
from bojax.experiments.settings import Planning
from tests.parts import tiny
from tests.protocol.lanes import each_kind, of_experiment

# No curve of these paths is tighter than a robot can drive.
PATHS = {"kind": "kernel", "first_angle": 0.785, "turn_angle": 1.257, "num_samples": 3}


# Compared with plain NumPy, and run in lanes, in tests/planning.
@each_kind("planner", traced=["gps-abt", "kcbts", "sbo"])
def test_a_planner_plans(kind, check):
    schema = tiny("planner", kind)
    # A planner with an objective of its own needs a field.
    problem = "parking" if getattr(schema, "objective", None) is None else "space-modelling"
    settings = {"problem": tiny("problem", problem).model_dump(), "planner": schema.model_dump()}
    episode = build(Planning.model_validate(settings))
    check(episode.planner, of_experiment(lambda episode: episode.planner, scores), episode)


# Run in tests/problems, in lanes, and compared there with what they are made of.
@each_kind("problem", traced=["hilly-terrain", "indoor-props", "monitoring"])
def test_a_problem_is_planned_on(kind, check):
    problem = tiny("problem", kind).model_dump()
    planner = {"kind": "random", "motions": PATHS}
    episode = build(Planning.model_validate({"problem": problem, "planner": planner}))
    check(episode.problem, of_experiment(lambda episode: episode.problem, scores), episode)


def scores(episode, carry):
    # The coarse grid of the tiny map has no point between props, where `gap_height` is null.
    return {name: score for name, score in episode.summary(carry).items() if name != "gap_height"}
