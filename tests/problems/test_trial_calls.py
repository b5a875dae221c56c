"""A field or a pose problem of a user's class is called once before anything runs."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bojax.fields.base import Field
from bojax.problems.pose import Outcome, PoseProblem
from tests.refusals import assert_refused


class Plane(Field):
    slope: Float[Array, "2"]

    def __call__(self, x):
        return x @ self.slope


class Vector(Plane):
    def __call__(self, x):
        return x * self.slope


class Misspelt(Plane):
    def __call__(self, x):
        return x @ self.slop


class Line(PoseProblem):
    """Drive along a line; `broken` names what is wrong."""

    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    broken: str = eqx.field(static=True, default="")
    max_steps: int = eqx.field(static=True, default=3)
    # All numbers that may be wrong are one program
    origin: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.0))
    bonus: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0.0))
    skipped: Int[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(0))
    calls: ClassVar[list[int]] = []

    def start(self, key):
        return jnp.full(2 if self.broken == "start" else 3, self.origin)

    def outcome(self, start, path):
        no = jnp.zeros((), bool)
        self.calls.append(1)
        reward = path[-1, 0] + (len(self.calls) if self.broken == "a counter" else self.bonus)
        last = len(path) - 1 + self.skipped
        outcome = Outcome(reward, terminated=no, success=no, exited=no, last=last)
        wrong = {"reward": 1.0, "success": path[-1, 0], "last": 1.5}
        if self.broken not in wrong:
            return outcome
        return eqx.tree_at(lambda each: getattr(each, self.broken), outcome, wrong[self.broken])


def test_fields_of_other_than_one_value_are_refused():
    Plane(jnp.ones(2))
    lost = "^Misspelt: a trial call failed: AttributeError: 'Misspelt' object has no attribute 'slop'"
    shape = r"^Vector: the value at a point has shape \(2,\); allowed: one number"
    assert_refused([(lambda: Vector(jnp.ones(2)), shape), (lambda: Misspelt(jnp.ones(2)), lost)])


def test_a_problem_whose_outcome_does_not_fit_is_refused():
    Line(jnp.asarray(0.1), jnp.asarray(0.1))
    assert_refused(
        (lambda broken=broken: Line(jnp.asarray(0.1), jnp.asarray(0.1), broken), f"^Line: .*{message}")
        for broken, message in (
            ("start", r"start is float64 of shape \(2,\); allowed: float64 of shape \(3,\)"),
            ("reward", r"Outcome.reward is float; allowed: float64 of shape \(\)"),
            ("success", r"Outcome.success is float64 of shape \(\); allowed: bool of shape \(\)"),
            ("last", "Outcome.last is not one integer"),
            ("a counter", "not pure: two calls with equal arguments differ"),
        )
    )


def test_a_problem_may_be_made_in_a_trace():
    line = Line(jnp.asarray(0.1), jnp.asarray(0.1))
    jax.jit(lambda: dataclasses.replace(line).start(jax.random.key(0)))()


def test_a_problem_with_wrong_numbers_is_refused():
    assert_refused(
        (
            lambda name=name, value=value: Line(
                jnp.asarray(0.1), jnp.asarray(0.1), **{name: jnp.asarray(value)}
            ),
            f"^Line: {message}",
        )
        for name, value, message in (
            ("origin", jnp.nan, "start: a pose is not finite"),
            ("bonus", jnp.inf, "Outcome.reward is not finite"),
            ("skipped", 90, "Outcome.last is 99 for a path of 10 poses; allowed: from 0 to 9"),
            ("skipped", -12, "Outcome.last is -3 for"),
        )
    )
