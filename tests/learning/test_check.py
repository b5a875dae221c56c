"""A user's learner and schedule are checked before they run, and every misfit is named in one line."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.envs.base import Env
from bojax.envs.spaces import Box, Discrete
from bojax.learning.base import ExplorationState, Learner
from bojax.learning.check import check_learner, check_schedule, check_spaces, check_weight
from bojax.learning.exploration_rewards import ExplorationReward
from bojax.learning.schedules import Schedule
from bojax.learning.tabular import AdditiveRewards
from bojax.results.schema import Column
from tests.refusals import assert_refused, without_annotation_checks


class Values(dict):
    """What methods return, as a static field, which JAX compares and hashes."""

    __hash__ = object.__hash__
    __eq__ = object.__eq__


class Still(Learner):
    """Takes the action 0; `wrong` is what a method or property returns instead."""

    weight: Float[Array, ""]
    wrong: Values = eqx.field(static=True, default_factory=Values)
    block: int = eqx.field(static=True, default=2)

    @property
    def exploration_weight(self):
        return self.wrong.get("weight", self.weight)

    def init(self, key, observation_space, action_space, capacity):
        return self.wrong.get("init", {"q": jnp.zeros(3, self.weight.dtype)})

    def act(self, key, state, observation, exploration):
        return self.wrong.get("act", (jnp.zeros(1, self.weight.dtype), state["q"][0]))

    def observe(self, key, state, transition, exploration, step_in_block):
        if self.wrong.get("branches") and transition.terminated:
            return state
        return self.wrong.get("observe", state)

    def flush(self, state):
        return self.wrong.get("flush", state)

    def end_episode(self, key, state, episode, exploration):
        return state["u"] if self.wrong.get("misspelt") else state

    def values(self, state, observation, action):
        return self.wrong.get("values", (state["q"][0], state["q"][1]))

    @property
    def columns(self):
        return self.wrong.get("columns", ())

    def summary(self, state):
        return self.wrong.get("summary", {})

    def check_spaces(self, observation_space, action_space):
        if self.wrong.get("spaces"):
            observation_space.missing()


ONE = jnp.ones(1, jnp.float32)
BOX = Box(-ONE, ONE)
SCALAR = r"allowed: float32 of shape \(\)"
MISFITS = {
    r"state\['q'\] of init is float; allowed: float32": {"init": {"q": 0.0}},
    r"act returns float32 of shape \(1,\); allowed: an action and": {"act": ONE},
    r"the action of act is int64 of shape \(1,\); allowed: float32 of": {"act": (ONE.astype(int), ONE[0])},
    r"the action of act is float32 of shape \(\); allowed: .*\(1,\)": {"act": (ONE[0], ONE[0])},
    rf"the expected return of act is float32 of shape \(1,\); {SCALAR}": {"act": (ONE, ONE)},
    r"state\['q'\] of observe is float32 of shape \(1,\); allowed: .*\(3,\)": {"observe": {"q": ONE}},
    "a value that JAX traces is used in an if": {"branches": True},
    "the state of flush differs in structure from the first": {"flush": None},
    r"a trial call failed: KeyError: 'u' \(test_check.py, line": {"misspelt": True},
    "values returns float32 of .*; allowed: Q and U": {"values": ONE[0]},
    rf"U of values is float; {SCALAR}": {"values": (ONE[0], 0.0)},
    r"columns is \['best'\]; allowed: a tuple of bojax.results.schema.Column": {"columns": ["best"]},
    r"summary returns \['best'\]; allowed: the names of columns, \[\]": {"summary": {"best": ONE[0]}},
    r"summary returns \[\]; allowed: the names of columns, \['b'\]": {"columns": (Column("b", "bool"),)},
    r"best of summary is float32 of shape \(1,\); allowed: float64 of shape \(\)": {
        "columns": (Column("best", "float64"),),
        "summary": {"best": ONE},
    },
    r"best of summary is float32 of shape \(\); allowed: int32 of shape \(\)": {
        "columns": (Column("best", "int32"),),
        "summary": {"best": ONE[0]},
    },
}


class Wrong(ExplorationReward):
    """A reward with a misspelt name."""

    def __call__(self, count, next_counts):
        return self.missing


class Half(Schedule):
    """Scale 0.5."""

    scale: Float[Array, ""]
    wrong: Values = eqx.field(static=True, default_factory=Values)

    def __call__(self, episode, has_reached):
        if "all" in self.wrong:
            return self.wrong["all"]
        return ExplorationState(self.wrong.get("scale", self.scale), self.wrong.get("learns", episode >= 0))


def test_misfits_of_a_learner_and_a_schedule_are_named_and_those_that_fit_pass():
    weight = jnp.float32(0.5)

    def learner(wrong):
        return Still(weight, Values(wrong))

    assert_refused(
        (lambda wrong=wrong: check_learner(learner(wrong), BOX, BOX), f"^Still: .*{message}")
        for message, wrong in MISFITS.items()
    )
    weights = {
        r"exploration_weight is float32 of shape \(1,\); allowed: floating-point": {"weight": ONE},
        "exploration_weight is float; allowed": {"weight": 1.0},
    }
    assert_refused(
        (lambda wrong=wrong: check_weight(learner(wrong)), f"^Still: {message}")
        for message, wrong in weights.items()
    )
    assert_refused(
        [
            (lambda: check_weight(Still(weight, block=0)), "^Still: block is 0; allowed: an integer >= 1"),
            (lambda: check_weight(Still(1.0)), "^Still.weight is a float; allowed: an array"),
        ]
    )
    q_learning = AdditiveRewards(weight, weight, weight, "first", 2, weight, Wrong())
    failed = r"^learner: Still: check_spaces failed: AttributeError: .* \(test_check.py, line"
    assert_refused([(lambda: check_spaces(learner({"spaces": True}), BOX, BOX), failed)])
    part = "^Wrong: a trial call failed: AttributeError: 'Wrong' object has no attribute 'missing'"
    assert_refused([(lambda: check_learner(q_learning, Discrete(3), Discrete(2)), part)])
    schedules = {
        "returns float; allowed: an ExplorationState": {"all": 0.5},
        "ExplorationState.scale is float; allowed: floating-point": {"scale": 0.5},
        r"ExplorationState.is_learning is float32 .*; allowed: bool": {"learns": weight},
    }
    with without_annotation_checks():
        assert_refused(
            (
                lambda wrong=wrong: check_schedule(Half(weight, Values(wrong))),
                f"^Half: {message}",
            )
            for message, wrong in schedules.items()
        )
    check_weight(learner({}))
    check_spaces(learner({}), BOX, BOX)
    check_learner(learner({}), BOX, BOX)
    check_schedule(Half(weight.astype(jnp.float64)))


class Counter(Still):
    """Adds the rewards of steps that it learns from; `wrong` names what it does besides."""

    mistake: str = eqx.field(static=True, default="")

    def init(self, key, observation_space, action_space, capacity):
        return {"q": jnp.full(3, 0.5, self.weight.dtype), "key": key}

    def act(self, key, state, observation, exploration):
        if self.mistake == "act":
            state["q"] = state["q"] + 1.0
        return state["q"][:1], state["q"][0]

    def observe(self, key, state, transition, exploration, step_in_block):
        learns = exploration.is_learning | (self.mistake == "observe")
        return {**state, "q": state["q"] + jnp.where(learns, transition.reward, 0.0)}

    def flush(self, state):
        return {**state, "q": 0.9 * state["q"]} if self.mistake == "flush" else state

    def end_episode(self, key, state, episode, exploration):
        return {**state, "q": 0.5 * state["q"]} if self.mistake == "end_episode" else state

    def policy_state(self, state):
        return {**state, "q": -state["q"]} if self.mistake == "policy_state" else state


def test_calls_that_must_not_change_a_learner_do_not():
    """They are made for a run that has ended, too: its result would depend on how long the others go on."""
    weight = jnp.float32(0.5)
    idle = "changes the state although exploration.is_learning is false"
    messages = {
        "observe": f"observe {idle}; allowed: the same state",
        "end_episode": f"end_episode {idle}; allowed: the same state",
        "flush": "flush changes the state although nothing is pending; allowed: the same state",
        "act": "act changes its state in place; allowed: observe and end_episode return a new one",
        "policy_state": "act takes another action in what policy_state exports; allowed: the same action",
    }
    check_learner(Counter(weight), BOX, BOX)
    assert_refused(
        (lambda name=name: check_learner(Counter(weight, mistake=name), BOX, BOX), f"^Counter: {message}$")
        for name, message in messages.items()
    )


class Beyond(Still):
    """Takes the action with the number of actions, as if they were counted from 1."""

    def act(self, key, state, observation, exploration):
        return jnp.asarray(2, jnp.int32), state["q"][0]


def test_an_action_outside_of_a_finite_space_is_refused():
    """A table would take its last column instead."""
    learner = Beyond(jnp.float32(0.5))
    check_learner(learner, BOX, Discrete(3))
    message = "^Beyond: act takes the action 2; allowed: 0 to 1$"
    assert_refused([(lambda: check_learner(learner, BOX, Discrete(2)), message)])


def test_names_of_methods_of_learners_and_environments_are_not_given_to_helpers():
    """A helper `summary` or `adapter` would be called by bojax after the run, or for a saved policy."""

    def declared(base, **attributes):
        return lambda: type("Own", (base,), {"__module__": "own", **attributes})

    assert_refused(
        [
            (declared(Learner, summary=lambda self: 1.0), r"^Own.summary: .* has summary\(self, state\);"),
            (declared(Learner, columns=3), "^Own.columns: bojax's Learner has the property columns;"),
            # The property would be taken for the default of the field.
            (
                declared(Learner, __annotations__={"exploration_weight": Float[Array, ""]}),
                "^Own.exploration_weight: bojax's Learner has the property exploration_weight;",
            ),
            (declared(Env, adapter=lambda self, x: x), r"^Own.adapter: bojax's Env has adapter\(self\);"),
        ],
        TypeError,
    )
    declared(Learner, check_spaces=lambda self, ours, theirs: None, fitted=Learner.fitted)()
