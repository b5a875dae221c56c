"""Settings of the environments with numbered states, and of the learners that keep a table."""

from typing import Annotated, ClassVar, Literal, Self

import pydantic
from pydantic import Field

from bojax.config.component import Component, Slot
from bojax.config.envs import Environment
from bojax.config.learners import LearnerSettings


class CliffWalking(Environment, frozen=True):
    """Walk along a cliff to a goal, on a grid of 4 x 12 (Sutton & Barto, Example 6.6)."""

    target: ClassVar[str] = "bojax.envs.cliff_walking:CliffWalking"

    kind: Literal["cliff-walking"] = "cliff-walking"
    max_steps: int = Field(default=1000, ge=1, description="steps after which an episode is cut off")
    slip: float = Field(
        default=0.01, ge=0, le=1, description="probability that the direction is drawn anew from all four"
    )
    reward_scale: float = Field(default=1.0, gt=0, description="factor of every reward")
    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only", description="1 for the goal and -1 for a fall; or -1 a step and -100 for a fall"
    )


class Taxi(Environment, frozen=True):
    """Fetch a passenger on a grid of 5 x 5 and bring them to their destination (Dietterich 2000)."""

    target: ClassVar[str] = "bojax.envs.taxi:Taxi"

    kind: Literal["taxi"] = "taxi"
    max_steps: int = Field(default=1000, ge=1, description="steps after which an episode is cut off")
    reward_scale: float = Field(default=1.0, gt=0, description="factor of every reward")
    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only",
        description="1 for the right drop-off and -0.1 for a wrong drop-off or pick-up; or 20, -10, and -1 "
        "a step",
    )


class Chain(Environment, frozen=True):
    """Walk a chain of N states to its end, where a step to the right may lead left (thesis, Fig. 5.6a)."""

    target: ClassVar[str] = "bojax.envs.chain:Chain"

    kind: Literal["chain"] = "chain"
    max_steps: int = Field(default=1000, ge=1, description="steps after which an episode is cut off")
    length: int = Field(default=10, ge=2, description="number of states (N); a sweep over it compiles once")
    sparsity: float = Field(
        default=1.0, ge=0, le=1, description="p: a state that is not the goal pays -1 with probability 1 - p"
    )
    start: int = Field(default=0, ge=0, description="state that an episode starts in; 0 is the first")
    max_length: int = Field(default=20, ge=2, description="number of observations that are declared")

    @pydantic.model_validator(mode="after")
    def _fits(self) -> Self:
        if self.length > self.max_length:
            raise ValueError(f"length: at most max_length, which is {self.max_length}; got {self.length}")
        if self.start >= self.length - 1:
            raise ValueError(f"start: less than length - 1, which is the goal; got {self.start}")
        return self


class _ExplorationReward(Component, frozen=True):
    role: ClassVar[str] = "exploration-reward"


class FirstVisit(_ExplorationReward, frozen=True):
    """0 for the first visit of a state and action, -1 for any other (thesis, p. 118)."""

    target: ClassVar[str] = "bojax.learning.exploration_rewards:FirstVisit"

    kind: Literal["first-visit"] = "first-visit"


class NextUncertainty(_ExplorationReward, frozen=True):
    """Mean uncertainty 1 / sqrt(1 + visits) of the next state's actions, less 1 (thesis, 5.9)."""

    target: ClassVar[str] = "bojax.learning.exploration_rewards:NextUncertainty"

    kind: Literal["next-uncertainty"] = "next-uncertainty"


class _Tabular(LearnerSettings, frozen=True):
    """What every tabular learner can be told."""

    learning_rate: float = Field(
        default=0.1, ge=0, le=1, description="share of the way to its target that a value goes"
    )
    initial_q: float = Field(default=0.0, description="Q of what was never tried")
    ties: Literal["random", "first"] = Field(
        default="random", description="which of several best actions is taken"
    )
    block: int = Field(default=16, ge=1, description="steps between two looks at whether all runs have ended")


_ExploresBy = Annotated[Component, Slot("exploration-reward")]


class ExplorationValues(_Tabular, frozen=True):
    """Q-learning with a second table U of exploration rewards; acts by argmax Q + kappa U."""

    target: ClassVar[str] = "bojax.learning.tabular:ExplorationValues"

    kind: Literal["exploration-values"] = "exploration-values"
    kappa: float = Field(default=1.0, ge=0, description="weight of U in the choice of actions")
    initial_u: float = Field(default=0.0, description="U of what was never tried")
    exploration_reward: _ExploresBy = Field(
        default=FirstVisit(), description="what exploring a transition is worth"
    )
    bootstrap: Literal["greedy-q", "policy", "max"] = Field(
        default="greedy-q",
        description="what follows a state: its greatest Q and U of argmax Q + kappa U, both of that action "
        "(5.7), or the greatest of each",
    )
    terminal_u: Literal["masked", "bootstrap"] = Field(
        default="masked", description="U of an absorbing state: 0, or what stands in the table"
    )


class AdditiveRewards(_Tabular, frozen=True):
    """Q-learning of rewards plus xi times exploration rewards (thesis, 5.1)."""

    target: ClassVar[str] = "bojax.learning.tabular:AdditiveRewards"

    kind: Literal["additive"] = "additive"
    xi: float = Field(default=1.0, ge=0, description="weight of exploration rewards")
    exploration_reward: _ExploresBy = Field(
        default=FirstVisit(), description="what exploring a transition is worth"
    )


class EpsilonGreedy(_Tabular, frozen=True):
    """Q-learning that takes a random action with probability epsilon."""

    target: ClassVar[str] = "bojax.learning.tabular:EpsilonGreedy"

    kind: Literal["epsilon-greedy"] = "epsilon-greedy"
    epsilon: float = Field(default=0.1, ge=0, le=1, description="probability of a random action")
