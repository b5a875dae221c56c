"""Episodes of uniformly random actions, held for a number of steps: exploration without learning."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Env
from bojax.experiments.learning_episodes import Starts, env_of_run, reset_key, shares_start
from bojax.numerics.lanes import LANES, any_lane


class RandomEpisode(eqx.Module):
    """An episode, or several `[N]`."""

    total: Float[Array, "*N"]  # sum of its rewards
    length: Int[Array, "*N"]  # number of its steps
    success: Bool[Array, "*N"]  # whether it reached the goal


def random_episodes(
    env: Env, starts: Starts, run: Key[Array, "N"], number: Int[Array, "N"], hold: Int[Array, "N"]
) -> RandomEpisode:
    """Episodes, each of one run, all in one batch.

    They begin where the training episodes of a learner begin with the same keys of runs. Episodes of a run
    count from 1; each action is repeated for `hold` steps.
    """
    return jax.vmap(lambda *each: _episode(env, starts, *each), axis_name=LANES)(run, number, hold)


def _episode(
    env: Env, starts: Starts, run: Key[Array, ""], number: Int[Array, ""], hold: Int[Array, ""]
) -> RandomEpisode:
    state = env_of_run(env, run).reset(reset_key(run, number, 0, shares_start(starts)))
    key = jax.random.fold_in(jax.random.fold_in(run, number), 1)
    zero = jnp.zeros((), jnp.int32)

    def step(loop):
        time, state, action, episode, is_active = loop
        keys = jax.random.split(jax.random.fold_in(key, time))
        action = jnp.where(time % hold == 0, env.action_space.sample(keys[0]), action)
        after, made = env.step(keys[1], state, action)
        episode = RandomEpisode(
            episode.total + jnp.where(is_active, made.reward, jnp.zeros_like(made.reward)),
            episode.length + is_active.astype(jnp.int32),
            episode.success | (is_active & made.success),
        )
        # The state of an episode that has ended goes on, which does not matter.
        return time + 1, after, action, episode, is_active & ~(made.terminated | made.truncated)

    reward = jax.eval_shape(env.step, key, state, env.action_space.example)[1].reward
    episode = RandomEpisode(jnp.zeros((), reward.dtype), zero, jnp.zeros((), bool))
    loop = zero, state, env.action_space.example, episode, jnp.ones((), bool)
    loop = jax.lax.while_loop(lambda loop: any_lane(loop[4]) & (loop[0] < env.max_steps), step, loop)
    return loop[3]
