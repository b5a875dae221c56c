"""The tiger problem (Kaelbling, Littman and Cassandra, 1998), whose value is known exactly."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.problems.actions import Discrete
from bojax.problems.state_space import StateProblem


class Tiger(StateProblem):
    """A tiger behind the left door (0) or the right one (1); listen (0), open left (1) or open right (2).

    An observation is the side that the tiger is heard on. A door that is opened places the tiger anew, and
    then what is heard says nothing.

    Settings: `bojax.problems.pomdp.settings.Tiger`.
    """

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
    def observe(
        self,
        key: Key[Array, ""],
        state: Float[Array, "1"],
        action: Float[Array, "1"],
        next_state: Float[Array, "1"],
    ) -> Float[Array, "1"]:
        is_right = jax.random.bernoulli(key, self._accuracy(action), (1,))
        return jnp.where(is_right, next_state, 1.0 - next_state)

    @override
    def log_likelihood(
        self,
        observation: Float[Array, "1"],
        state: Float[Array, "1"],
        action: Float[Array, "1"],
        next_state: Float[Array, "1"],
    ) -> Float[Array, ""]:
        accuracy = self._accuracy(action)
        return jnp.log(jnp.where(observation[0] == next_state[0], accuracy, 1.0 - accuracy))

    def _accuracy(self, action: Float[Array, "1"]) -> Float[Array, ""]:
        return jnp.where(action[0] == 0.0, self.accuracy, 0.5)
