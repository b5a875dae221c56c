"""A field or a pose problem of a user's class is called once before anything runs."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

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

    def start(self, key):
        return jnp.zeros(2 if self.broken == "start" else 3, self.position_noise.dtype)

    def outcome(self, start, path):
        no = jnp.zeros((), bool)
        outcome = Outcome(path[-1, 0], terminated=no, success=no, exited=no, last=jnp.asarray(len(path) - 1))
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
        )
    )
