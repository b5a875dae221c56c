"""Every learner: it learns and is tested in two episodes of a chain."""

import equinox as eqx

from bojax.engine.build import build
from bojax.experiments.settings import Learning
from tests.parts import each_kind, tiny
from tests.protocol.lanes import advance_twice, check

CHAIN = {"kind": "chain", "length": 3, "max_length": 3, "sparsity": 0.5, "max_steps": 4}


@each_kind("learner")
def test_a_learner_learns_and_is_tested(kind):
    settings = {"env": CHAIN, "learner": tiny("learner", kind).model_dump(), "episodes": 2, "tests": 1}
    run = build(Learning.model_validate(settings))

    def learn(learner, key, run):
        run = eqx.tree_at(lambda run: run.learner, run, learner)
        carry, tables = advance_twice(run, key)
        return run.summary(carry)["return"], tables["episodes"], learner.policy_state(carry.learner)

    check(run.learner, learn, inputs=run)
