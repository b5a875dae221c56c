"""An environment of bojax in Gymnasium code: pump the car up the hill."""

import numpy as np

import bojax
from bojax.envs.gymnasium import GymnasiumEnv

env = GymnasiumEnv(bojax.part("mountain-car"))
observation, _ = env.reset(seed=0)
num_steps, is_over = 0, False
while not is_over:
    velocity = observation[1]
    action = np.array([1.0 if velocity >= 0 else -1.0], np.float32)
    observation, reward, terminated, truncated, info = env.step(action)
    num_steps, is_over = num_steps + 1, terminated or truncated

print(f"steps to the goal: {num_steps}")
print(f"reward of the last one: {reward}")
