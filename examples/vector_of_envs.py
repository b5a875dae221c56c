"""An environment of bojax as a vector of Gymnasium, and with the interface of gymnax in a compiled loop."""

import jax
import numpy as np

import bojax
from bojax.envs.gymnasium_vector import GymnasiumVectorEnv
from bojax.envs.gymnax import GymnaxEnv

car = bojax.part("mountain-car")


def pump(velocity):
    """The force in the direction of the velocity."""
    return np.where(velocity >= 0.0, 1.0, -1.0).astype(np.float32)


vector = GymnasiumVectorEnv(car, num_envs=64)
observations, _ = vector.reset(seed=0)
goals = 0
for _ in range(300):
    actions = pump(observations[:, 1:])
    observations, rewards, terminated, truncated, info = vector.step(actions)
    goals += int(info["success"].sum())
print(f"goals of 64 cars in 300 steps: {goals}")

env = GymnaxEnv(car)


@jax.jit
def goals_of(params, key):
    """Number of goals in 300 steps of a car with these parameters."""
    observation, state = env.reset(key, params)

    def step(carry, key):
        observation, state = carry
        action = 2.0 * (observation[1:] >= 0.0) - 1.0
        observation, state, reward, done, info = env.step(key, state, action, params)
        return (observation, state), info["success"]

    return jax.lax.scan(step, (observation, state), jax.random.split(key, 300))[1].sum()


keys = jax.random.split(jax.random.key(0), 64)
goals = jax.vmap(goals_of, in_axes=(None, 0))(env.default_params, keys)
print(f"goals of 64 compiled cars: {goals.sum()}")
