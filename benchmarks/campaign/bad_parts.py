"""A problem and an environment whose numbers go wrong now and then, as a user's own may."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box
from bojax.motions.base import Pose
from bojax.problems.pose import Outcome, PoseProblem

WRONG = {"nan": jnp.nan, "inf": jnp.inf, "minus-inf": -jnp.inf, "huge": 1e308, "tiny": 5e-324}
"""Numbers that a part may give, by name: a config holds finite numbers alone."""


def _some(key: Key[Array, ""], value: Array, share: Array, wrong: str) -> Array:
    """The value, or with probability `share` a wrong one."""
    return jnp.where(jax.random.uniform(key, (), value.dtype) < share, WRONG[wrong], value)


class Meadow(PoseProblem):
    """Stay near the origin; the reward is wrong where the heading, taken as a random number, says so."""

    share: Float[Array, ""]
    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    wrong: str = eqx.field(static=True, default="nan")
    max_steps: int = eqx.field(static=True, default=4)

    @override
    def start(self, key: Key[Array, ""]) -> Pose:
        return jax.random.uniform(key, (3,), self.share.dtype, -1.0, 1.0)

    @override
    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        del start
        end = path[-1]
        is_wrong = jnp.mod(jnp.abs(end[2]) * 1e3, 1.0) < self.share
        reward = jnp.where(is_wrong, WRONG[self.wrong], -jnp.hypot(end[0], end[1]))
        no = jnp.zeros((), bool)
        return Outcome(reward, terminated=no, success=no, exited=no, last=jnp.asarray(path.shape[0] - 1))


class Rail(Env):
    """A puck on a rail; reward or observation are wrong at random."""

    share: Float[Array, ""]
    wrong: str = eqx.field(static=True, default="nan")
    where: str = eqx.field(static=True, default="reward")
    max_steps: int = eqx.field(static=True, default=20)

    @property
    @override
    def observation_space(self) -> Box:
        one = jnp.ones((1,), self.share.dtype)
        return Box(-one, one)

    @property
    @override
    def action_space(self) -> Box:
        return self.observation_space

    @override
    def reset(self, key: Key[Array, ""]) -> Float[Array, "1"]:
        return jax.random.uniform(key, (1,), self.share.dtype, -1.0, 0.0)

    @override
    def observe(self, state: Float[Array, "1"]) -> Float[Array, "1"]:
        return state

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "1"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "1"], TimeStep]:
        after = jnp.clip(state + 0.1 * jnp.clip(action, -1.0, 1.0), -1.0, 1.0)
        success = after[0] > 0.9
        reward = success.astype(state.dtype)
        if self.where == "reward":
            reward = _some(key, reward, self.share, self.wrong)
        else:
            after = _some(key, after[0], self.share, self.wrong)[None]
        return after, TimeStep(after, reward, success, jnp.zeros_like(success), success)
