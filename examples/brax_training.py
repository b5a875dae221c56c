"""Brax trains a linear policy on an environment of bojax, by augmented random search."""

from brax.training.agents.ars import train as ars

import bojax
from bojax.envs.brax import BojaxEnv

pendulum = bojax.part("single-pendulum", reward="classic", classic_ends_at_goal=False)
_, _, metrics = ars.train(
    BojaxEnv(pendulum),
    num_timesteps=8000,
    episode_length=50,
    number_of_directions=8,
    top_directions=4,
    num_evals=2,
    num_eval_envs=16,
)
print(f"mean return of 16 episodes: {metrics['eval/episode_reward']:.1f}")
