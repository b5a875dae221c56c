"""Settings of learners, their features and exploration rewards, and of schedules of exploration."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component, Slot


class FeatureSettings(Component, frozen=True):
    """Features of states and actions."""

    role: ClassVar[str] = "features"
    plural: ClassVar[str] = "features of states and actions"


class RandomFourierFeatures(FeatureSettings, frozen=True):
    """Random Fourier features of a stationary kernel over state and action (thesis, equation 2.33)."""

    target: ClassVar[str] = "bojax.learning.features:RandomFourierSpec"

    kind: Literal["random-fourier"] = "random-fourier"
    state_lengthscale: float = Field(
        default=0.3, gt=0, description="lengthscale along each observation, in units of its range"
    )
    action_lengthscale: float = Field(default=0.3, gt=0, description="the same of actions")
    num_features: int = Field(default=300, ge=2, multiple_of=2, description="number of features (M)")
    kernel: Literal["rbf", "matern12", "matern32", "matern52"] = Field(
        default="rbf", description="kernel that they approximate"
    )
    sampling: Literal["quasi-random", "monte-carlo"] = Field(
        default="quasi-random", description="how frequencies are drawn"
    )
    form: Literal["cos-sin", "phase"] = Field(
        default="cos-sin", description="cosines and sines, or cosines with random phases and half the norm"
    )


class FourierBasisFeatures(FeatureSettings, frozen=True):
    """The Fourier basis over state and action (thesis, equation 5.23)."""

    target: ClassVar[str] = "bojax.learning.features:FourierBasisSpec"

    kind: Literal["fourier-basis"] = "fourier-basis"
    order: int = Field(default=3, ge=1, description="half periods along a dimension: (order + 1)^D features")


class Indicators(FeatureSettings, frozen=True):
    """One feature for each pair of a numbered state and a numbered action."""

    target: ClassVar[str] = "bojax.learning.features:OneHotSpec"

    kind: Literal["indicators"] = "indicators"


class LearnerSettings(Component, frozen=True):
    """A learner."""

    role: ClassVar[str] = "learner"
    plural: ClassVar[str] = "learners"
    protocol: ClassVar[str] = "bojax.learning.base:Learner"

    discount: float = Field(default=0.99, gt=0, le=1, description="discount of rewards per step (gamma)")


# What the two kinds of EMU-Q differ in.
_FeaturesOfEMUQ = Annotated[Component, Slot("features"), Field(description="features of state and action")]
_RewardOrder = Annotated[
    Literal["before", "after"],
    Field(description="exploration reward before or after the covariance has seen the step"),
]
_TerminalQ = Annotated[
    Literal["zero", "bootstrap"], Field(description="Q of an absorbing state: zero, or what the model says")
]
_TerminalU = Annotated[
    Literal["absorbing", "bootstrap", "zero"],
    Field(description="U of an absorbing state: r_e for ever, what the model says, or zero"),
]
_OptimisticU = Annotated[bool, Field(description="whether U is 0 where nothing was seen")]
_HasNoise = Annotated[bool, Field(description="whether 1/beta is part of the variance")]
_MixesTransitions = Annotated[
    bool, Field(description="whether the refit averages exploration rewards over the wrong axis")
]


class _EMUQ(LearnerSettings, frozen=True):
    target: ClassVar[str] = "bojax.learning.emu_q:EMUQ"

    features: _FeaturesOfEMUQ = RandomFourierFeatures()
    prior_precision: float = Field(default=0.1, gt=0, description="precision of every weight (alpha)")
    noise_precision: float = Field(default=1.0, gt=0, description="precision of the targets (beta)")
    discount: float = Field(default=0.99, gt=0, lt=1, description="discount of rewards per step (gamma)")
    kappa: float = Field(default=1.0, ge=0, description="weight of exploration, in units of 1/V_max = alpha")
    num_actions: int = Field(default=15, ge=1, description="candidates of the argmax over actions")
    num_samples: int = Field(default=10, ge=1, description="actions of the mean in the exploration reward")
    draw_actions: Literal["once", "always"] = Field(
        default="always", description="whether these are drawn once for a run, evenly, or anew each time"
    )
    refine_steps: int = Field(default=0, ge=0, description="steps that refine the best candidate")
    reward_order: _RewardOrder = "before"
    terminal_q: _TerminalQ = "zero"
    terminal_u: _TerminalU = "absorbing"
    optimistic_u: _OptimisticU = False
    has_noise: _HasNoise = False
    refit: Literal["sweeps", "direct", "none"] = Field(
        default="sweeps", description="how Q and U are fitted to all transitions after an episode"
    )
    max_sweeps: int = Field(default=30, ge=1, description="most sweeps, or policies evaluated directly")
    tolerance: float = Field(default=0.1, ge=0, description="change of the weights at which sweeps stop")
    mixes_transitions: _MixesTransitions = False
    block: int = Field(default=16, ge=1, description="steps between two flushes of the covariance")
    refit_block: int = Field(default=512, ge=1, description="transitions at a time during a refit")


class EMUQ(_EMUQ, frozen=True):
    """Exploration by minimising the uncertainty of Q values (thesis, Section 5.6, Algorithm 6)."""

    kind: Literal["emu-q"] = "emu-q"


class EMUQPublished(_EMUQ, frozen=True):
    """EMU-Q as the author's published code has it, quirks included."""

    kind: Literal["emu-q-published"] = "emu-q-published"
    features: _FeaturesOfEMUQ = RandomFourierFeatures(form="phase")
    reward_order: _RewardOrder = "after"
    terminal_q: _TerminalQ = "bootstrap"
    terminal_u: _TerminalU = "bootstrap"
    optimistic_u: _OptimisticU = True
    has_noise: _HasNoise = True
    mixes_transitions: _MixesTransitions = True

    @property
    def label(self) -> str:
        """It is EMU-Q."""
        return "emu-q"


class RFFQ(LearnerSettings, frozen=True):
    """Q-learning on linear features, epsilon-greedy (thesis, Sections 5.6.4 and 5.7)."""

    target: ClassVar[str] = "bojax.learning.rff_q:RFFQ"

    kind: Literal["rff-q"] = "rff-q"
    features: Annotated[Component, Slot("features")] = Field(
        default=RandomFourierFeatures(), description="features of state and action"
    )
    learning_rate: float = Field(default=0.5, gt=0, description="step of the gradient descent")
    normalise: bool = Field(
        default=True, description="whether the rate is divided by the squared norm of the features"
    )
    epsilon: float = Field(default=0.1, ge=0, le=1, description="probability of a random action")
    initial_weight: float = Field(default=0.0, ge=0, description="standard deviation of the first weights")
    num_actions: int = Field(default=15, ge=1, description="candidates of the argmax over actions")
    block: int = Field(default=16, ge=1, description="steps between two looks at whether an episode is over")


class ExplorationRewardSettings(Component, frozen=True):
    """An exploration reward."""

    role: ClassVar[str] = "exploration-reward"
    plural: ClassVar[str] = "exploration rewards"
    protocol: ClassVar[str] = "bojax.learning.exploration_rewards:ExplorationReward"


class FirstVisit(ExplorationRewardSettings, frozen=True):
    """0 for the first visit of a state and action, -1 for any other (thesis, p. 118)."""

    target: ClassVar[str] = "bojax.learning.exploration_rewards:FirstVisit"

    kind: Literal["first-visit"] = "first-visit"


class NextUncertainty(ExplorationRewardSettings, frozen=True):
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


class ScheduleSettings(Component, frozen=True):
    """A schedule of exploration: how it changes over a learning run."""

    role: ClassVar[str] = "schedule"
    plural: ClassVar[str] = "schedules of exploration"
    protocol: ClassVar[str] = "bojax.learning.schedules:Schedule"


class Constant(ScheduleSettings, frozen=True):
    """The same exploration in every episode."""

    target: ClassVar[str] = "bojax.learning.schedules:Constant"

    kind: Literal["constant"] = "constant"


class Decay(ScheduleSettings, frozen=True):
    """Exploration times 1 / (1 + c t), t the number of episodes before (thesis, p. 121)."""

    target: ClassVar[str] = "bojax.learning.schedules:Decay"

    kind: Literal["decay"] = "decay"
    rate: float = Field(default=0.1, ge=0, description="c, per episode")


class Budget(ScheduleSettings, frozen=True):
    """Exploration for some episodes, none after them; or again later (thesis, p. 119)."""

    target: ClassVar[str] = "bojax.learning.schedules:Budget"

    kind: Literal["budget"] = "budget"
    episodes: int = Field(default=30, ge=0, description="episodes with exploration")
    resume_after: int | None = Field(
        default=None, ge=1, description="episodes without it, before it goes on for good; null: never"
    )
    learns_without: bool = Field(default=False, description="whether learning goes on without exploration")


class UntilTarget(ScheduleSettings, frozen=True):
    """Exploration until the test episodes reach their target (thesis, p. 123)."""

    target: ClassVar[str] = "bojax.learning.schedules:UntilTarget"

    kind: Literal["until-target"] = "until-target"
    learns_after: bool = Field(default=False, description="whether learning goes on after that")


class Exploit(ScheduleSettings, frozen=True):
    """Neither exploration nor learning: an evaluation of what a learner knows."""

    target: ClassVar[str] = "bojax.learning.schedules:Exploit"

    kind: Literal["exploit"] = "exploit"
