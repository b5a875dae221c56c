"""A user's environment is checked before it runs, and every misfit is named in one line."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float

from bojax.envs.base import Env, TimeStep
from bojax.envs.check import check_env
from bojax.envs.spaces import Box


class Cart(Env):
    """A cart on a rail; each test breaks one method."""

    speed: Float[Array, ""]
    max_steps: int = eqx.field(static=True, default=5)

    @property
    def observation_space(self):
        return Box(-jnp.ones(1, self.speed.dtype), jnp.ones(1, self.speed.dtype))

    @property
    def action_space(self):
        return self.observation_space

    def reset(self, key):
        return {"x": jax.random.uniform(key, (1,), self.speed.dtype)}

    def observe(self, state):
        return state["x"]

    def step(self, key, state, action):
        x = state["x"] + self.speed * action
        no = jnp.zeros((), bool)
        return {"x": x}, TimeStep(x, -jnp.sum(x), no, no, no)


class WideReward(Cart):
    def step(self, key, state, action):
        after, step = super().step(key, state, action)
        return after, eqx.tree_at(lambda s: s.reward, step, jnp.where(step.success, 1.0, 0.0))


class PythonReward(Cart):
    def step(self, key, state, action):
        after, step = super().step(key, state, action)
        return after, eqx.tree_at(lambda s: s.reward, step, 0.0)


class NumericEnd(Cart):
    def step(self, key, state, action):
        after, step = super().step(key, state, action)
        return after, eqx.tree_at(lambda s: s.terminated, step, step.reward)


class LongObservation(Cart):
    def observe(self, state):
        return jnp.concatenate([state["x"], state["x"]])


class WideState(Cart):
    def step(self, key, state, action):
        after, step = super().step(key, state, action)
        return {"x": after["x"].astype(jnp.float64)}, step


class OtherState(Cart):
    def step(self, key, state, action):
        after, step = super().step(key, state, action)
        return after["x"], step


class NoTimeStep(Cart):
    def step(self, key, state, action):
        return super().step(key, state, action)[0]


class ScalarBounds(Cart):
    @property
    def observation_space(self):
        return eqx.tree_at(lambda box: box.low, super().observation_space, self.speed)


class WideBounds(Cart):
    @property
    def action_space(self):
        return Box(-jnp.ones(1), jnp.ones(1))


class Misspelt(Cart):
    def reset(self, key):
        return {"x": self.sped}


MISFITS = {
    WideReward: "TimeStep.reward is float64 of shape (); allowed: float32 of shape (); use the dtype of",
    PythonReward: "TimeStep.reward is float; allowed: float32 of shape (); use the dtype",
    NumericEnd: "TimeStep.terminated is float32 of shape (); allowed: bool of shape ()",
    LongObservation: "the observation of observe is float32 of shape (2,); allowed: float32 of shape (1,)",
    WideState: "state['x'] of step is float64 of shape (1,); allowed: float32 of shape (1,)",
    OtherState: "the states of reset and step differ in structure",
    NoTimeStep: "step has to return the next state and a TimeStep",
    ScalarBounds: "observation_space.low has shape ()",
    WideBounds: "action_space.low is float64 of shape (1,)",
    Misspelt: "a trial call failed: AttributeError: 'Misspelt' object has no attribute 'sped' (test_check",
}


def test_a_misfit_is_named():
    for broken, message in MISFITS.items():
        with pytest.raises(ValueError) as error:
            check_env(broken(jnp.float32(0.1)), jnp.float32)
        assert str(error.value).startswith(f"{broken.__name__}: ")
        assert message in str(error.value)


def test_a_python_number_in_place_of_an_array_is_named():
    env = eqx.tree_at(lambda env: env.speed, Cart(jnp.float32(0.1)), 0.1)
    with pytest.raises(
        ValueError, match=r"^Cart.speed is a float; allowed: an array, as jnp.asarray\(0.1\)$"
    ):
        check_env(env, jnp.float32)


def test_an_environment_of_the_precision_of_the_run_passes():
    for dtype in (jnp.float32, jnp.float64):
        check_env(Cart(jnp.asarray(0.1, dtype)), dtype)
