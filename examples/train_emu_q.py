"""Train EMU-Q on an environment of Gymnasium, then let Gymnasium run what it learned."""

import gymnasium

from bojax.engine.training import train

env = {"kind": "gymnasium", "id": "MountainCarContinuous-v0", "success": "terminated", "max_steps": 300}
features = {"num_features": 100, "state_lengthscale": 0.3, "action_lengthscale": 10.0}
learner = {"kind": "emu-q", "features": features}
training = train(env, learner, episodes=5, runs=4)
print("episodes to the goal:", training.runs["episodes_to_goal"].to_pylist())

policy, steps, is_over = training.policy(run=0), 0, False
world = gymnasium.make("MountainCarContinuous-v0", max_episode_steps=300)
observation, _ = world.reset(seed=0)
while not is_over:
    observation, _, terminated, truncated, _ = world.step(policy(observation))
    steps, is_over = steps + 1, terminated or truncated
print("steps of what run 0 has learned:", steps)
