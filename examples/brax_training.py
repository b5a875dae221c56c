"""Brax trains a linear policy on an environment of bojax, by augmented random search."""

from brax.training.agents.ars import train as ars

from bojax.engine.build import build
from bojax.envs.brax import BojaxEnv
from bojax.envs.settings import SinglePendulum

pendulum = SinglePendulum(reward="classic", classic_ends_at_goal=False)
_, _, metrics = ars.train(
    BojaxEnv(build(pendulum, dtype="float32")),
    num_timesteps=8000,
    episode_length=50,
    number_of_directions=8,
    top_directions=4,
    num_evals=2,
    num_eval_envs=16,
)
print(f"mean return of 16 episodes: {metrics['eval/episode_reward']:.1f}")
