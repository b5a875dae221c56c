"""VDP Tag: tag a target that follows a Van der Pol oscillator (Sunberg and Kochenderfer, ICAPS 2018)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Box, Mixed
from bojax.problems.pomdp.readings import Beams, ReadingProblem, beam_towards, length_of
from bojax.results.outline import Outline


class VdpTag(ReadingProblem):
    """An agent that barriers on the axes stop, and a target that they do not.

    A state is the agent's position, then the target's. An action is an angle in [0, 2 pi] and whether to
    look (0 or 1). All eight beams read at every step; a look makes the target's beam exact, at a price.

    Settings: `bojax.problems.pomdp.settings.VdpTag`.
    """

    damping: Float[Array, ""]
    time_step: Float[Array, ""]
    target_noise: Float[Array, ""]
    step_length: Float[Array, ""]
    barrier_start: Float[Array, ""]
    barrier_end: Float[Array, ""]
    half_width: Float[Array, ""]
    tag_radius: Float[Array, ""]
    tag_reward: Float[Array, ""]
    step_reward: Float[Array, ""]
    look_reward: Float[Array, ""]
    look_noise: Float[Array, ""]
    noise: Float[Array, ""]
    empty_reading: Float[Array, ""]
    discount: Float[Array, ""]
    num_substeps: int = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def actions(self) -> Mixed:
        dtype = self.discount.dtype
        angles = Box(jnp.zeros(1, dtype), jnp.full(1, 2.0 * jnp.pi, dtype), is_angle=True)
        return Mixed(angles, jnp.asarray([0.0, 1.0], dtype))

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "4"]:
        dtype, half = self.discount.dtype, self.half_width
        return jnp.concatenate([jnp.zeros(2, dtype), jax.random.uniform(key, (2,), dtype, -half, half)])

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "4"], action: Float[Array, "2"]
    ) -> tuple[Float[Array, "4"], Float[Array, ""], Bool[Array, ""]]:
        noise = self.target_noise * jax.random.normal(key, (2,), state.dtype)
        target = self.drift(state[2:]) + noise
        next_state = jnp.concatenate([self.move(state[:2], action[0]), target])
        tagged = length_of(next_state[2:] - next_state[:2]) < self.tag_radius
        reward = jnp.where(tagged, self.tag_reward, self.step_reward)
        return next_state, reward + action[1] * self.look_reward, tagged

    @override
    def sketch(self, state: Float[Array, "4"]) -> dict[str, Float[Array, "2"]]:
        return {"agent": state[:2], "target": state[2:]}

    @override
    def outline(self) -> Outline:
        start, end, thin = self.barrier_start, self.barrier_end, 0.03
        across = [(start, -thin, end, thin), (-end, -thin, -start, thin)]
        return Outline(obstacles=[*across, *((y0, x0, y1, x1) for x0, y0, x1, y1 in across)])

    def drift(self, target: Float[Array, "2"]) -> Float[Array, "2"]:
        """The target's next position without noise: x' = mu (x - x^3 / 3 - y), y' = x / mu, by RK4."""

        # Within a substep, coordinates are scalars: a vector at each stage would be a kernel of its own on a
        # GPU. A vector after each substep lets a CPU compute many lanes at once.
        def velocity(x: Float[Array, ""], y: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
            return self.damping * (x - x**3 / 3.0 - y), x / self.damping

        step = self.time_step
        for _ in range(self.num_substeps):
            x, y = target
            x1, y1 = velocity(x, y)
            x2, y2 = velocity(x + 0.5 * step * x1, y + 0.5 * step * y1)
            x3, y3 = velocity(x + 0.5 * step * x2, y + 0.5 * step * y2)
            x4, y4 = velocity(x + step * x3, y + step * y3)
            slopes = jnp.stack([x1 + 2.0 * x2 + 2.0 * x3 + x4, y1 + 2.0 * y2 + 2.0 * y3 + y4])
            target = target + step / 6.0 * slopes
        return target

    def move(self, agent: Float[Array, "2"], angle: Float[Array, ""]) -> Float[Array, "2"]:
        """The agent's next position: a straight move that ends just before the first barrier."""
        move = self.step_length * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        # The fraction of the move after which each coordinate is 0, and the other coordinate there: the
        # barriers lie on the half axes, so that this decides whether one is hit.
        fraction = -agent / jnp.where(move == 0.0, 1.0, move)
        where = jnp.abs(agent[::-1] + fraction * move[::-1])
        is_hit = (self.barrier_start <= where) & (where <= self.barrier_end)
        is_hit = is_hit & (move != 0.0) & (0.0 <= fraction) & (fraction < 1.0)
        margin = 2.0 * jnp.finfo(agent.dtype).eps
        return agent + jnp.min(jnp.where(is_hit, fraction - margin, 1.0)) * move

    @override
    def reading(self, action: Float[Array, "2"], next_state: Float[Array, "4"]) -> Beams:
        offset = next_state[2:] - next_state[:2]
        noise = jnp.where(action[1] > 0.0, self.look_noise, self.noise)
        index = beam_towards(offset, self.num_beams)
        return Beams(index, length_of(offset), noise, self.empty_reading, self.noise, self.num_beams)
