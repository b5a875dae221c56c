"""The generative model of a continuous POMDP, written for one particle."""

import abc
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key

from bojax.problems.actions import ActionSpace

State = Float[Array, "D"]
Action = Float[Array, "K"]
Observation = Float[Array, "O"]
Step = tuple[State, Float[Array, ""], Bool[Array, ""]]
"""The next state, the reward, and whether the next state is terminal."""


class StateModel(eqx.Module):
    """How a state follows from an action, what is observed, and how likely an observation is; all vectors.

    Every method is written for one state and is a pure function of its arguments. A terminal state is never
    stepped in the world; in a belief it may be, and must not give NaN.

    Attributes:
        discount: Discount of the reward per step, in (0, 1].
        has_discrete_observations: Whether the same observation can occur twice with positive probability: it
            has finitely many values, or one that says that nothing is seen. POMCPOW then plans on one branch
            for all that are equal.
    """

    discount: eqx.AbstractVar[Float[Array, ""]]
    has_discrete_observations: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def actions(self) -> ActionSpace:
        """The actions, and how a planner parametrises them."""

    @abc.abstractmethod
    def initial(self, key: Key[Array, ""]) -> State:
        """A state drawn from the initial belief."""

    @abc.abstractmethod
    def step(self, key: Key[Array, ""], state: State, action: Action) -> Step:
        """The next state, the reward, and whether the next state is terminal."""

    @abc.abstractmethod
    def observe(self, key: Key[Array, ""], state: State, action: Action, next_state: State) -> Observation:
        """An observation after a step."""

    @abc.abstractmethod
    def log_likelihood(
        self, observation: Observation, state: State, action: Action, next_state: State
    ) -> Float[Array, ""]:
        """Logarithm of the density, or of the probability, of an observation after a step."""

    def heuristic_value(self, state: State) -> Float[Array, ""] | None:
        """Value of a state if states were observed (MDP), as a leaf value; None if it is not known."""
        return None
