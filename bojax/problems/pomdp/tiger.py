"""The tiger problem (Kaelbling, Littman and Cassandra, 1998), whose value is known exactly."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Discrete
from bojax.problems.pomdp.readings import BinaryReading, ReadingProblem


class Tiger(ReadingProblem):
    """A tiger behind the left door (0) or the right one (1); listen (0), open left (1) or open right (2).

    An observation is the side that the tiger is heard on. A door that is opened places the tiger anew, and
    then what is heard says nothing.

    Settings: `bojax.problems.pomdp.settings.Tiger`.
    """

    has_discrete_observations: ClassVar[bool] = True

    listen_reward: Float[Array, ""]
    tiger_reward: Float[Array, ""]
    treasure_reward: Float[Array, ""]
    accuracy: Float[Array, ""]
    discount: Float[Array, ""]
    max_steps: int = eqx.field(static=True)

    @property
    @override
    def actions(self) -> Discrete:
        return Discrete(jnp.asarray([[0.0], [1.0], [2.0]], self.discount.dtype))

    @override
    def initial(self, key: Key[Array, ""]) -> Float[Array, "1"]:
        return jax.random.bernoulli(key, shape=(1,)).astype(self.discount.dtype)

    @override
    def step(
        self, key: Key[Array, ""], state: Float[Array, "1"], action: Float[Array, "1"]
    ) -> tuple[Float[Array, "1"], Float[Array, ""], Bool[Array, ""]]:
        listens = action[0] == 0.0
        finds_tiger = action[0] == state[0] + 1.0
        opened = jnp.where(finds_tiger, self.tiger_reward, self.treasure_reward)
        next_state = jnp.where(listens, state, self.initial(key))
        return next_state, jnp.where(listens, self.listen_reward, opened), jnp.zeros((), bool)

    @override
    def heuristic_value(self, state: Float[Array, "1"]) -> Float[Array, ""]:
        # With the tiger's place known, the best policy opens the other door at all `max_steps` steps.
        weights = self.discount ** jnp.arange(self.max_steps, dtype=self.discount.dtype)
        return jnp.maximum(self.treasure_reward, self.listen_reward) * jnp.sum(weights)

    @override
    def reading(self, action: Float[Array, "1"], next_state: Float[Array, "1"]) -> BinaryReading:
        return BinaryReading(next_state, jnp.where(action[0] == 0.0, self.accuracy, 0.5))

    @override
    def sketch(self, state: Float[Array, "1"]) -> dict[str, Float[Array, "1"]]:
        return {"the tiger's door: 0 left, 1 right": state}
