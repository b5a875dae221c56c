"""Every planner and every problem: two paths are planned, driven and learned from."""

import equinox as eqx

from bojax.engine.build import build
from bojax.experiments.settings import Planning
from tests.parts import each_kind, tiny
from tests.protocol.lanes import advance_twice, check

# No curve of these paths is tighter than a robot can drive.
PATHS = {"kind": "kernel", "first_angle": 0.785, "turn_angle": 1.257, "num_samples": 3}


def drive(episode, key):
    """The scores of an episode of two steps, and the rows of its steps."""
    carry, tables = advance_twice(episode, key)
    return episode.summary(carry), tables["steps"]


@each_kind("planner")
def test_a_planner_plans(kind):
    schema = tiny("planner", kind)
    # A planner with an objective of its own needs a field.
    problem = "parking" if getattr(schema, "objective", None) is None else "space-modelling"
    settings = {"problem": tiny("problem", problem).model_dump(), "planner": schema.model_dump()}
    episode = build(Planning.model_validate(settings))

    def plan(planner, key, episode):
        return drive(eqx.tree_at(lambda episode: episode.planner, episode, planner), key)

    check(episode.planner, plan, inputs=episode)


@each_kind("problem")
def test_a_problem_is_planned_on(kind):
    problem = tiny("problem", kind).model_dump()
    planner = {"kind": "random", "motions": PATHS}
    episode = build(Planning.model_validate({"problem": problem, "planner": planner}))

    def play(problem, key, episode):
        return drive(eqx.tree_at(lambda episode: episode.problem, episode, problem), key)

    check(episode.problem, play, inputs=episode)
