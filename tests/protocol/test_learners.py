"""Every learner: it learns and is tested in two episodes of a chain."""

from bojax.engine.build import build
from bojax.experiments.settings import Learning
from tests.parts import tiny
from tests.protocol.lanes import each_kind, of_experiment

CHAIN = {"kind": "chain", "length": 3, "max_length": 3, "sparsity": 0.5, "max_steps": 4}


# Compared with plain NumPy in tests/learning; RFF-Q learns in lanes in test_envs.
COMPARED = ["additive", "bootstrapped-q", "dora", "emu-q", "exploration-values", "rff-q", "rnd", "vime"]


@each_kind("learner", traced=COMPARED)
def test_a_learner_learns_and_is_tested(kind, check):
    settings = {"env": CHAIN, "learner": tiny("learner", kind).model_dump(), "episodes": 2, "tests": 1}
    run = build(Learning.model_validate(settings))
    check(run.learner, of_experiment(lambda run: run.learner, learned), run)


def learned(run, carry):
    return run.summary(carry)["last_return"], run.learner.policy_state(carry.learner)
