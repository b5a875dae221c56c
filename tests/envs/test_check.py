"""A user's environment is checked before it runs, and every misfit is named in one line."""

import random
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from beartype import beartype
from jaxtyping import Array, Float

from bojax.envs.base import Env, TimeStep
from bojax.envs.check import check_env
from bojax.envs.spaces import Box, Discrete
from tests.refusals import assert_refused


@beartype
def _total(terms: list[Array]) -> Array:
    return sum(terms, start=jnp.zeros_like(terms[0]))


class Cart(Env):
    """A cart on a rail; `broken` names what is wrong."""

    speed: Float[Array, ""]
    broken: str = eqx.field(static=True, default="")
    max_steps: int = eqx.field(static=True, default=5)

    @property
    def observation_space(self):
        one = jnp.ones(1, self.speed.dtype)
        box = Box(-one, one)
        if self.broken == "scalar bounds":
            return eqx.tree_at(lambda box: box.low, box, self.speed)
        spaces = {
            "no elements": Discrete(0),
            "equal bounds": Box(one, one),
            "infinite bounds": Box(-one, jnp.inf * one),
        }
        return spaces.get(self.broken, box)

    @property
    def action_space(self):
        one = jnp.ones(1, None if self.broken == "wide bounds" else self.speed.dtype)
        return Box(-one, one)

    def reset(self, key):
        return {
            "x": self.sped if self.broken == "misspelt" else jax.random.uniform(key, (1,), self.speed.dtype)
        }

    def counts(self, state):
        return {"bumps": jnp.zeros((), jnp.int32)} if self.broken == "undeclared count" else {}

    def observe(self, state):
        return jnp.tile(state["x"], 2 if self.broken == "long observation" else 1)

    def step(self, key, state, action):
        x = state["x"] + self.speed * action
        if self.broken == "draws of the host":
            x = x + jnp.asarray(np.random.normal(), x.dtype)
        if self.broken == "a generator of its own":
            x = x + jnp.asarray(np.random.default_rng().normal(), x.dtype)
        if self.broken == "checked by beartype":
            x = _total([x] * 3)
        if self.broken == "draws of Python":
            x = x + random.random()
        no = jnp.zeros((), bool)
        result = TimeStep(x, -jnp.sum(x), no, no, no)
        wrong = {
            "wide reward": ("reward", jnp.where(no, 1.0, 0.0)),
            "python reward": ("reward", 0.0),
            "numeric end": ("terminated", result.reward),
        }
        if self.broken in wrong:
            name, value = wrong[self.broken]
            result = eqx.tree_at(lambda result: getattr(result, name), result, value)
        states = {"wide state": {"x": x.astype(jnp.float64)}, "other state": x}
        after = states.get(self.broken, {"x": x})
        return after if self.broken == "no time step" else (after, result)


SINGLE = r"allowed: float32 of shape \("
MISFITS = {
    "wide reward": rf"TimeStep.reward is float64 of shape \(\); {SINGLE}\); use the dtype of",
    "python reward": rf"TimeStep.reward is float; {SINGLE}\); use the dtype",
    "numeric end": r"TimeStep.terminated is float32 of shape \(\); allowed: bool of shape \(\)",
    "long observation": rf"the observation of observe is float32 of shape \(2,\); {SINGLE}1,\)",
    "wide state": rf"state\['x'\] of step is float64 of shape \(1,\); {SINGLE}1,\)",
    "undeclared count": r"counts returns \['bumps'\]; allowed: the names of count_columns, \[\]",
    "other state": "the state of step differs in structure from the first",
    "no time step": "step has to return the next state and a TimeStep",
    "scalar bounds": r"observation_space.low has shape \(\)",
    "wide bounds": r"action_space.low is float64 of shape \(1,\)",
    "no elements": "observation_space.num is 0; allowed: an integer >= 1",
    "draws of the host": "draws from numpy.random or random, once for all steps and runs; allowed: jax",
    "misspelt": r"a trial call failed: AttributeError: 'Cart' object has no attribute 'sped' \(test_check",
}


def test_a_misfit_is_named_and_an_environment_that_fits_passes(monkeypatch):
    speed = jnp.float32(0.1)
    assert_refused(
        (lambda broken=broken: check_env(Cart(speed, broken), jnp.float32), f"^Cart: .*{message}")
        for broken, message in MISFITS.items()
    )
    # Also where the trial is cached: JAX caches no trace that raised.
    draws = (
        lambda: check_env(Cart(speed, "draws of the host"), jnp.float32),
        "^Cart: draws from numpy.random",
    )
    own = lambda: check_env(Cart(speed, "a generator of its own"), jnp.float32), "^Cart: not pure: two calls"
    bounds = [
        (
            lambda broken=broken: check_env(Cart(speed, broken), jnp.float32),
            rf"^observation_space: .*{found};",
        )
        for broken, found in {"equal bounds": "1.0 to 1.0", "infinite bounds": "-1.0 to inf"}.items()
    ]
    no_steps = (
        lambda: check_env(Cart(speed, max_steps=0), jnp.float32),
        "^Cart: max_steps is 0; allowed: an",
    )
    assert_refused([draws, own, *bounds, no_steps])
    number = eqx.tree_at(lambda env: env.speed, Cart(speed), 0.1)
    array = r"^Cart.speed is a float; allowed: an array, as jnp.asarray\(0.1\)$"
    assert_refused([(lambda: check_env(number, jnp.float32), array)])
    for dtype in (jnp.float32, jnp.float64):
        check_env(Cart(jnp.asarray(0.1, dtype)), dtype)
    # Beartype draws from Python's generator to choose the item that it checks.
    check_env(Cart(speed, "checked by beartype"), jnp.float32)
    monkeypatch.delitem(sys.modules, "beartype")
    assert_refused(
        [
            (
                lambda: check_env(Cart(speed, "draws of Python"), jnp.float32),
                "^Cart: draws from numpy.random or random",
            )
        ]
    )
