"""A state problem of a user's class with a mistake ends in one line before anything runs."""

from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.stats import norm
from jaxtyping import Array, Float, Int

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.experiments.planning import PlanningEpisode
from bojax.planning.belief_planner import PolicyPlanner
from bojax.problems.actions import Box, Discrete, Mixed
from bojax.problems.state_checks import check_model
from bojax.problems.state_space import StateProblem
from tests.refusals import assert_refused, without_annotation_checks
from tests.tiers import by_tier

NUMBERS = ["", *"actions bounds reward value density nan weights".split(), "no noise", "a constant"]
NUMBERS += ["of the state before", "a smaller noise", "the other side"]
"""Mistakes that are numbers: all are one program, which compiles for longer than any other test runs."""


class Line(StateProblem):
    """A position with a noisy reading; `number`, of `NUMBERS`, or `mistake` say what is wrong."""

    discount: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.9))
    noise: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.5))
    number: Int[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0, jnp.int32))
    mistake: str = eqx.field(static=True, default="")
    max_steps: int = eqx.field(static=True, default=5)

    def has(self, mistake):
        return self.number == NUMBERS.index(mistake)

    @property
    def actions(self):
        low = jnp.where(self.has("actions"), jnp.ones(1), -jnp.ones(1))
        return Box(low, jnp.where(self.has("bounds"), jnp.inf, -low))

    def initial(self, key):
        return jnp.zeros(()) if self.mistake == "initial" else jax.random.normal(key, (1,), float)

    def step(self, key, state, action):
        moved = state + action + 0.1 * jax.random.normal(key, (1,), float)
        if self.mistake == "python's random numbers":
            moved = moved + np.random.default_rng().normal()
        if self.mistake == "a callback":
            draw = lambda _: np.random.default_rng().normal()  # noqa: E731
            shape = jax.ShapeDtypeStruct((), moved.dtype)
            moved = moved + jax.pure_callback(draw, shape, moved, vmap_method="sequential")
        if self.mistake == "python's if" and action[0] > 0.0:
            return state, -1.0, False
        if self.mistake == "exit":
            raise SystemExit(3)
        if self.mistake == "numpy":
            moved = moved + np.sin(state)
        if self.mistake == "python's list":
            moved = moved + [0.0, 1.0][(state[0] > 0.0).astype(int)]
        if self.mistake == "two values":
            return moved, -1.0
        if self.mistake == "python's Boolean":
            return moved, jnp.ones_like(moved[0]), False
        reward = jnp.where(self.has("reward"), jnp.sqrt(moved[0]), jnp.abs(moved[0]))
        return moved, -reward, moved[0] > 3.0

    def heuristic_value(self, state):
        value = jnp.where(self.has("value"), jnp.nan, state[0])
        return value[None] if self.mistake == "values" else value

    def filter(self, key, belief, action, observation):
        filtered = super().filter(key, belief, action, observation)
        return filtered[0] if self.mistake == "filter" else filtered

    def sketch(self, state):
        return {"x": jnp.stack([state[0]] * 3)} if self.mistake == "sketch" else super().sketch(state)

    def observe(self, key, state, action, next_state):
        if self.mistake == "observation":
            return next_state[0] + self.noise * jax.random.normal(key, (), float)
        noise = jnp.where(self.has("no noise"), 0.0, self.noise)
        return next_state + noise * jax.random.normal(key, (1,), float)

    def log_likelihood(self, observation, state, action, next_state):
        offset = observation[0] - next_state[0]
        if self.mistake == "one value a reading":
            return norm.logpdf(observation, next_state, self.noise)
        right = norm.logpdf(offset, 0.0, self.noise)
        wrong = {
            "no noise": jnp.where(offset == 0.0, 0.0, -jnp.inf),
            "density": norm.pdf(offset, 0.0, self.noise),
            "a constant": -jnp.ones_like(offset),
            "nan": jnp.log(offset),
            "of the state before": norm.logpdf(observation[0], state[0], self.noise),
            "a smaller noise": norm.logpdf(offset, 0.0, 0.1 * self.noise),
        }
        return jnp.stack([wrong.get(name, right) for name in NUMBERS])[self.number]


def line(mistake, kind=Line):
    if mistake in NUMBERS:
        return kind(number=jnp.asarray(NUMBERS.index(mistake), jnp.int32))
    return kind(mistake=mistake)


class Coin(Line):
    """A reading of three values."""

    has_discrete_observations = True

    def observe(self, key, state, action, next_state):
        return jax.random.categorical(key, self._logits(next_state))[None].astype(float)

    def log_likelihood(self, observation, state, action, next_state):
        sides = (jax.nn.log_softmax(self._logits(state)) for state in (next_state, -next_state))
        logs, other = (side[observation[0].astype(int)] for side in sides)
        wrong = {"density": jnp.exp(logs), "weights": logs + 0.1, "the other side": other}
        return jnp.stack([wrong.get(name, logs) for name in NUMBERS])[self.number]

    def _logits(self, state):
        return jnp.stack([state[0], jnp.zeros_like(state[0]), -state[0]])


class ForgottenCoin(Coin):
    """A coin that does not say that readings come again."""

    has_discrete_observations = False


class CountedLine(Line):
    """A line that says that readings come again."""

    has_discrete_observations = True


class TracedLine(Line):
    """A line that counts how often its steps are traced."""

    traces: ClassVar[list[int]] = []

    def step(self, key, state, action):
        self.traces.append(1)
        return super().step(key, state, action)


def refused(problem):
    return lambda: check_model(problem)


def test_correct_problems_pass():
    for problem in (Line(), Line(noise=jnp.asarray(1e-3)), Coin(), Line(discount=jnp.asarray(1.0))):
        check_model(problem)


STATE_PROBLEMS = sorted(
    kind for kind, schema in kinds("problem").items() if schema.target.startswith("bojax.problems.pomdp.")
)
NORMAL = ["tiger", "light-dark", "light-dark-nd", "vdp-tag", "uncertain-pose"]


@pytest.mark.parametrize("kind", by_tier(STATE_PROBLEMS, normal=NORMAL))
def test_shipped_problems_would_pass(kind, monkeypatch):
    problem = build(kinds("problem")[kind]())
    monkeypatch.setattr(type(problem), "__module__", "somebody.elses")
    check_model(problem)


TRACED = (
    "a trial call failed: .* traces is used in an if.* or by NumPy; allowed: jnp.where, .* or jax.numpy "
    r"\(test_state_checks.py, line"
)


def test_a_problem_with_a_mistake_is_refused_in_one_line():
    mistakes = (
        ("actions", "actions: a random action is not in the action space"),
        ("bounds", "actions: a random action is not in the action space; allowed: finite bounds"),
        ("reward", "initial or step: a state or a reward is not finite"),
        ("value", "heuristic_value: the value of a state is not finite"),
        ("python's if", TRACED),
        ("exit", "a trial call failed: SystemExit: 3"),
        ("numpy", TRACED),
        ("python's list", TRACED),
        ("two values", "step: allowed: three values"),
        ("filter", "filter: allowed: two values"),
        ("python's random numbers", "not pure: two calls with equal arguments differ"),
        ("a callback", "not pure: two calls with equal arguments differ"),
        ("density", "log_likelihood is never negative, even far from all observations"),
        ("a constant", "log_likelihood is the same for all observations"),
        ("nan", "log_likelihood is NaN for an observation"),
        ("sketch", "sketch: allowed: a dictionary of vectors, all of 1 number or all of 2"),
        ("of the state before", "log_likelihood does not fit observe"),
        ("a smaller noise", "log_likelihood does not fit observe"),
        ("no noise", "log_likelihood: none of 1000 particles explains the first observation"),
    )
    assert_refused((refused(line(name)), f"^problem: Line: {message}") for name, message in mistakes)
    assert_refused(
        (
            refused(Line(discount=jnp.asarray(value))),
            f"^problem: Line: discount is {value:g}; allowed: above 0",
        )
        for value in (0.0, -0.5, 1.01)
    )


def test_counts_are_positive():
    assert_refused(
        (partial(Line, **{name: 0}), f"^{name}: got 0; allowed: >= 1$")
        for name in ("max_steps", "num_particles")
    )


def test_spaces_of_actions_are_made_of_rows_or_of_vectors_of_one_length_and_precision():
    box = Box(-jnp.ones(2), jnp.ones(2))
    given: list[Any] = [
        *((Discrete, values, "") for values in (3, jnp.arange(3.0), jnp.zeros((0, 1)))),
        (Box, -1.0, 1.0, "float and float"),
        (Box, [-1.0], [1.0], "list and list"),
        (Box, jnp.zeros(1), jnp.ones(2), r"float64 of shape \(1,\) and float64 of shape \(2,\)"),
        (Mixed, box, [0.0, 1.0], "Box and list"),
        (Mixed, box, jnp.asarray([0, 1]), r"Box and int64 of shape \(2,\)"),
        (Mixed, box, jnp.zeros((2, 1)), r"Box and float64 of shape \(2, 1\)"),
        (Mixed, box, jnp.zeros(0), r"Box and float64 of shape \(0,\)"),
        (Mixed, jnp.ones(2), jnp.zeros(2), r"\w+ and float64 of shape \(2,\)"),
    ]
    messages = {
        Discrete: "^Discrete: allowed: an array with a row of numbers for each action{}",
        Box: "^Box: got {}; allowed: two vectors of one length, as arrays",
        Mixed: "^Mixed: got {}; allowed: a Box, and a vector of levels",
    }
    with without_annotation_checks():
        assert_refused((partial(kind, *each), messages[kind].format(got)) for kind, *each, got in given)


def declared(**attributes):
    """A function that declares a class of lines with these attributes, and checks a problem of it."""
    return lambda: check_model(type("Own", (Line,), {"__module__": "own", **attributes})())


def test_names_of_methods_of_bojax_are_not_given_to_helpers():
    """`reward` with as many parameters would be called in place of the reward of `step`."""

    def other(self, state, action, next_state, is_caught):
        return -jnp.sum(next_state**2)

    message = r"^Own.{}: bojax's StateProblem has {}; allowed: the same, or another name$"
    reward = message.format("reward", r"reward\(self, objective, belief, action, events\)")
    assert_refused(
        [
            (declared(reward=other), reward),
            (declared(reward=100.0), reward),
            (declared(__annotations__={"reward": Float[Array, ""]}), reward),
            (declared(row=property(lambda self: 1.0)), message.format("row", r"row\(self, world\)")),
            (declared(step_columns=other), message.format("step_columns", "the property step_columns")),
        ],
        TypeError,
    )


def test_what_is_static_and_parameters_of_methods_are_checked():
    static, traced = partial(eqx.field, static=True), {"__annotations__": {"max_steps": int}}
    message = r"allowed: a field max_steps: int = eqx.field\(static=True, default=30\)"
    assert_refused(
        [
            (declared(**traced, max_steps=30), f"^problem: Own: max_steps: {message}"),
            (
                declared(__annotations__={"max_steps": float}, max_steps=static(default=30.0)),
                f"^problem: Own: max_steps: {message}",
            ),
            (
                declared(__annotations__={"discount": float}, discount=static(default=0.9)),
                "^problem: Own: discount is float; allowed: a field of an array",
            ),
            (
                declared(step=lambda self, state, action: state),
                r"^problem: Own: step: .*; allowed: step\(self, key, state, action\)$",
            ),
        ]
    )


def angles(turn):
    return property(lambda self: Box(jnp.zeros(1), jnp.full(1, turn), is_angle=True))


def test_angles_have_bounds_one_turn_apart_and_a_class_passes_whose_episodes_end_at_once():
    of_bounds = "^problem: Own: actions: is_angle, but the bounds of Box"
    assert_refused([(declared(actions=angles(2.0)), of_bounds)])

    def reward(self, objective, belief, action, events):
        return 2.0 * events.reward

    def step(self, key, state, action):  # particles need not explain the observation
        return *Line.step(self, key, state, action)[:2], jnp.asarray(True)

    declared(reward=reward, actions=angles(2.0 * np.pi), step=step)()


def test_wrong_shapes_are_refused():
    with without_annotation_checks():
        assert_refused(
            (refused(line(name)), f"^problem: Line: .*{message}")
            for name, message in (
                ("initial", r"initial is float64 of shape \(\); allowed: a vector of float64"),
                ("observation", r"observe is float64 of shape \(\); allowed: a vector of float64"),
                ("values", r"heuristic_value is float64 of shape \(1,\); allowed: .* \(\)"),
                ("python's Boolean", r"termination of step is bool; allowed: .*; use jnp.asarray\(x\)"),
                ("one value a reading", r"log_likelihood is float64 of shape \(1,\); allowed: .* \(\)"),
            )
        )


def test_finite_observations_have_the_probabilities_of_their_draws_and_come_again():
    total = "^problem: Coin: log_likelihood: the probabilities of 3 obs.* sum to "
    again = r"observe: \d+ obs.* have 3 values; allowed: has_discrete_observations = True"
    drawn = "the probability .*, but observe returns it in .*% of draws"
    assert_refused(
        (
            (refused(line("density", Coin)), f"{total}4"),
            (refused(line("weights", Coin)), rf"{total}1\.11"),
            (refused(line("the other side", Coin)), drawn),
            (refused(ForgottenCoin()), again),
            (refused(CountedLine()), "has_discrete_observations is True, but no observation comes again"),
        )
    )


def test_an_episode_checks_its_problem_and_the_action_of_its_policy():
    still = PolicyPlanner(lambda problem, key, belief: jnp.zeros(1))
    far = PolicyPlanner(lambda problem, key, belief: jnp.full(1, 7.0))
    PlanningEpisode(Line(num_particles=10), still)
    assert_refused(
        (
            (lambda: PlanningEpisode(line("nan"), still), "^problem: Line: .*NaN"),
            (lambda: PlanningEpisode(Line(), far), r"^planner.policy: .* is \[7.0\]; allowed"),
        )
    )
    # A list of actions too: the light is reached by moves of 10 only if there are such moves.
    with pytest.raises(ValueError, match="planner.policy: its action for an initial belief"):
        problem = build(kinds("problem")["light-dark"](moves=(-1, 0, 1)))
        PlanningEpisode(problem, PolicyPlanner("aside-first"))


def test_points_of_a_sweep_are_traced_once():
    still = PolicyPlanner(lambda problem, key, belief: jnp.zeros(1))
    counts = []
    for noise in (0.5, 0.4):
        PlanningEpisode(TracedLine(num_particles=10, noise=jnp.asarray(noise)), still)
        counts.append(len(TracedLine.traces))
    assert counts[0] == counts[1] > 0
