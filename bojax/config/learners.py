"""Settings of the learners with function approximation, and of their features."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bojax.config.component import Component, Slot


class _Features(Component, frozen=True):
    role: ClassVar[str] = "features"


class RandomFourierFeatures(_Features, frozen=True):
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


class FourierBasisFeatures(_Features, frozen=True):
    """The Fourier basis over state and action (thesis, equation 5.23)."""

    target: ClassVar[str] = "bojax.learning.features:FourierBasisSpec"

    kind: Literal["fourier-basis"] = "fourier-basis"
    order: int = Field(default=3, ge=1, description="half periods along a dimension: (order + 1)^D features")


class Indicators(_Features, frozen=True):
    """One feature for each pair of a numbered state and a numbered action."""

    target: ClassVar[str] = "bojax.learning.features:IndicatorSpec"

    kind: Literal["indicators"] = "indicators"


class LearnerSettings(Component, frozen=True):
    """What every learner can be told."""

    role: ClassVar[str] = "learner"

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
