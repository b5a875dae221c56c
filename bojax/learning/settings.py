"""Settings of learners, their features and exploration rewards, and of schedules of exploration."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field
from typing_extensions import override

from bojax.config.component import Component, Slot
from bojax.config.limits import LEVELS


class FeatureSettings(Component, frozen=True):
    """Features of states and actions."""

    role: ClassVar[str] = "features"
    plural: ClassVar[str] = "features of states and actions"
    protocol: ClassVar[str] = "bojax.learning.features:FeatureSpec"


class RandomFourierFeatures(FeatureSettings, frozen=True):
    """Random Fourier features of a stationary kernel over state and action (thesis, equation 2.33)."""

    target: ClassVar[str] = "bojax.learning.features:RandomFourierSpec"
    kind: Literal["random-fourier"] = "random-fourier"
    state_lengthscale: float = Field(
        default=0.3, gt=0, description="lengthscale along each observation, in units of its range (Table 5.2)"
    )
    action_lengthscale: float = Field(default=0.3, gt=0, description="the same along each action dimension")
    num_features: int = Field(default=300, ge=2, multiple_of=2, description="number of features (M), even")
    kernel: Literal["rbf", "matern12", "matern32", "matern52"] = Field(
        default="rbf", description="kernel that the features approximate"
    )
    sampling: Literal["quasi-random", "monte-carlo"] = Field(
        default="quasi-random",
        description="draws of the frequencies: a scrambled Halton sequence, or independent",
    )
    form: Literal["cos-sin", "phase"] = Field(
        default="cos-sin",
        description="cosines and sines of M/2 frequencies, with squared norm 1; or cosines of M frequencies"
        " with random phases times sqrt(1/M), as in the author's published code, where sqrt(2/M) would be "
        "right",
    )


class FourierBasisFeatures(FeatureSettings, frozen=True):
    """The Fourier basis over state and action (thesis, equation 5.23)."""

    target: ClassVar[str] = "bojax.learning.features:FourierBasisSpec"
    kind: Literal["fourier-basis"] = "fourier-basis"
    order: int = Field(
        default=3, ge=1, description="most half periods along a dimension; there are (order + 1)^D features"
    )


class NormalisedRBF(FeatureSettings, frozen=True):
    """Normalised radial basis functions: local features, with which values do not extrapolate."""

    target: ClassVar[str] = "bojax.learning.features:NormalisedRBFSpec"
    kind: Literal["normalised-rbf"] = "normalised-rbf"
    num_state_centres: int = Field(default=100, ge=1, description="number of centres in the observations")
    num_action_centres: int = Field(
        default=5, ge=1, description="number of centres in the actions; of a discrete space, one each"
    )
    width: float = Field(
        default=1.0, gt=0, description="width of a function, in units of the mean distance of centres"
    )


class OneHot(FeatureSettings, frozen=True):
    """One-hot features: one for each pair of a discrete state and a discrete action."""

    target: ClassVar[str] = "bojax.learning.features:OneHotSpec"
    kind: Literal["indicators"] = "indicators"


class AutoFeatures(FeatureSettings, frozen=True):
    """Features that need no settings: number and lengthscales follow from the spaces of the environment."""

    target: ClassVar[str] = "bojax.learning.auto_features:AutoSpec"
    kind: Literal["auto"] = "auto"


class LearnerSettings(Component, frozen=True):
    """A learner."""

    role: ClassVar[str] = "learner"
    plural: ClassVar[str] = "learners"
    protocol: ClassVar[str] = "bojax.learning.base:Learner"

    discount: float = Field(default=0.99, gt=0, le=1, description="discount of rewards per step (gamma)")


# Settings that several learners have.
_Features = Annotated[Component, Slot("features"), Field(description="features of states and actions")]
_NumCandidates = Annotated[
    int, Field(ge=1, description="number of candidates of the maximum over a continuous action space")
]
_Epsilon = Annotated[float, Field(ge=0, le=1, description="probability of a random action")]
_ActionsPerDimension = Annotated[
    int,
    Field(
        ge=2, description="number of actions along each dimension of a continuous action space, evenly spaced"
    ),
]
_Block = Annotated[
    int, Field(ge=1, description="number of steps between two checks of whether the episode has ended")
]

# Settings that differ between the two kinds of EMU-Q.
_RewardOrder = Annotated[
    Literal["before", "after"],
    Field(
        description="whether the exploration reward is computed before the covariance is updated by the "
        "transition (Algorithm 6), or after (published code)"
    ),
]
_TerminalQ = Annotated[
    Literal["zero", "bootstrap"],
    Field(description="Q of a terminal state: zero, or the prediction of the model (published code)"),
]
_TerminalU = Annotated[
    Literal["absorbing", "bootstrap", "zero"],
    Field(
        description="U of a terminal state: r_e / (1 - gamma), as if it paid r_e for ever; the prediction "
        "of the model (published code); or zero, with which ending early is the best exploration"
    ),
]
_OptimisticU = Annotated[
    bool, Field(description="whether U is scaled towards 0 where nothing was observed (published code)")
]
_HasNoise = Annotated[
    bool, Field(description="whether the variance in the exploration reward includes 1/beta (published code)")
]
_MixesTransitions = Annotated[
    bool,
    Field(description="whether the refit averages exploration rewards over the wrong axis (published code)"),
]
_Refit = Annotated[
    Literal["sweeps", "direct", "none"],
    Field(
        description="fit of Q and U at the end of an episode: sweeps over all transitions (published code), "
        "the direct solution of the equations that the sweeps converge to, or none"
    ),
]


class _EMUQ(LearnerSettings, frozen=True):
    target: ClassVar[str] = "bojax.learning.emu_q:EMUQ"

    features: _Features = RandomFourierFeatures()
    prior_precision: float = Field(default=0.1, gt=0, description="prior precision of every weight (alpha)")
    noise_precision: float = Field(default=1.0, gt=0, description="precision of the targets (beta)")
    discount: float = Field(default=0.99, gt=0, lt=1, description="discount of rewards per step (gamma)")
    u_discount: float | None = Field(
        default=None,
        ge=0,
        lt=1,
        description="discount of exploration rewards per step, in U; null for discount",
    )
    kappa: float = Field(default=1.0, ge=0, description="weight of exploration, in units of 1/V_max = alpha")
    num_actions: _NumCandidates = 15
    num_samples: int = Field(
        default=10, ge=1, description="number of continuous actions of the mean in the exploration reward"
    )
    draw_actions: Literal["once", "always"] = Field(
        default="always",
        description="whether candidates and mean actions are drawn once for a run, by a scrambled Halton "
        "sequence, or anew at each use, uniformly (published code)",
    )
    refine_steps: int = Field(default=0, ge=0, description="pattern search steps around the best candidate")
    reward_order: _RewardOrder = "before"
    terminal_q: _TerminalQ = "zero"
    terminal_u: _TerminalU = "absorbing"
    optimistic_u: _OptimisticU = False
    has_noise: _HasNoise = False
    refit: _Refit = "direct"
    refit_rewards: Literal["recomputed", "stored"] = Field(
        default="recomputed",
        description="exploration rewards of a refit: computed again with the covariance of that time (line "
        "16 of Algorithm 6), or stored as they were when the transitions were observed (line 8)",
    )
    max_sweeps: int = Field(
        default=30, ge=1, description="largest number of sweeps, or of policies solved directly"
    )
    tolerance: float = Field(
        default=0.1, ge=0, description="change of the weights (Euclidean norm) that ends sweeps, or policies"
    )
    mixes_transitions: _MixesTransitions = False
    clips_u: bool = Field(
        default=False,
        description="whether U of the next state is clipped in TD targets to the returns that exploration "
        "rewards allow, [-1 / (alpha (1 - gamma)), 0]",
    )
    block: int = Field(default=16, ge=1, description="number of steps between two flushes of the covariance")
    refit_block: int = Field(
        default=512, ge=1, description="number of transitions that a refit visits at a time, <= 64 on a CPU"
    )


class EMUQ(_EMUQ, frozen=True):
    """Exploration by minimising the uncertainty of Q values (thesis, Section 5.6, Algorithm 6)."""

    kind: Literal["emu-q"] = "emu-q"


class EMUQPublished(_EMUQ, frozen=True):
    """EMU-Q with the deviations of the author's published code from the printed algorithm."""

    kind: Literal["emu-q-published"] = "emu-q-published"
    features: _Features = RandomFourierFeatures(form="phase")
    reward_order: _RewardOrder = "after"
    terminal_q: _TerminalQ = "bootstrap"
    terminal_u: _TerminalU = "bootstrap"
    optimistic_u: _OptimisticU = True
    has_noise: _HasNoise = True
    refit: _Refit = "sweeps"
    mixes_transitions: _MixesTransitions = True

    @property
    @override
    def label(self) -> str:
        # Both classes are named EMU-Q in results.
        return "emu-q"


class RFFQ(LearnerSettings, frozen=True):
    """Epsilon-greedy Q-learning on linear features (thesis, Sections 5.6.4 and 5.7)."""

    target: ClassVar[str] = "bojax.learning.rff_q:RFFQ"
    kind: Literal["rff-q"] = "rff-q"
    features: _Features = RandomFourierFeatures()
    learning_rate: float = Field(default=0.5, gt=0, description="learning rate of the gradient descent")
    normalise: bool = Field(
        default=True,
        description="whether the rate is divided by the squared norm of the features, which is 1 for random"
        " Fourier features; for a Fourier basis the norm is half the number of features, and the same rate "
        "would diverge",
    )
    epsilon: _Epsilon = 0.1
    initial_weight: float = Field(default=0.0, ge=0, description="standard deviation of the initial weights")
    num_actions: _NumCandidates = 15
    block: _Block = 16


class RandomActions(LearnerSettings, frozen=True):
    """Uniformly random actions, which learn nothing: the baseline of exploration."""

    target: ClassVar[str] = "bojax.learning.random_actions:RandomActions"
    kind: Literal["random"] = "random"
    block: _Block = 16


class DORA(LearnerSettings, frozen=True):
    """Q-learning on tiles, explored by E-values (Fox et al., ICLR 2018; thesis, Section 5.7.2)."""

    target: ClassVar[str] = "bojax.learning.dora:DORA"
    kind: Literal["dora"] = "dora"
    policy: Literal["lll", "epsilon-greedy"] = Field(
        default="lll",
        description="argmax Q - temperature log(-log E), or argmax Q with random actions (default of the "
        "published code)",
    )
    temperature: float = Field(default=0.5, ge=0, description="weight of log(-log E) in the policy lll")
    epsilon: float = Field(default=0.3, ge=0, le=1, description="share of random actions if epsilon-greedy")
    xi: float = Field(default=1.0, ge=0, description="weight of the reward bonus log(1 - alpha_E) / log E")
    learning_rate: float = Field(default=0.1, gt=0, le=1, description="learning rate of Q, over num_tilings")
    e_learning_rate: float = Field(
        default=0.5, gt=0, lt=1, description="learning rate of E, over num_tilings (then alpha_E)"
    )
    e_discount: float = Field(default=0.99, ge=0, le=1, description="discount of E-values per step (gamma_E)")
    e_values: Literal["sigmoid", "linear"] = Field(
        default="sigmoid",
        description="E of the summed weights z: 1 / (1 + exp(-z)), from 1/2; or 1 + z, from 1 (the tables of "
        "the paper)",
    )
    derivative: Literal["at-e", "at-logit"] = Field(
        default="at-e",
        description="where updates of E before the end of an episode take the derivative of the sigmoid: at E"
        " (published code), or at the summed weights, as would be right",
    )
    initial_weight: float = Field(default=0.01, ge=0, description="standard deviation of Q's initial weights")
    num_tilings: int = Field(default=8, ge=1, description="number of tilings, and of tiles along a range")
    num_indices: int = Field(default=2048, ge=1, description="number of weights; further tiles share by hash")
    actions_per_dimension: _ActionsPerDimension = 3
    block: _Block = 16


class VIME(LearnerSettings, frozen=True):
    """TRPO with rewards for information gain about the dynamics (Houthooft et al., NeurIPS 2016)."""

    target: ClassVar[str] = "bojax.learning.vime:VIME"
    kind: Literal["vime"] = "vime"
    eta: float = Field(default=1e-4, ge=0, description="weight of the bonus (median about 1) in rewards")
    iteration_steps: int = Field(default=5000, ge=1, description="steps of whole episodes for an iteration")
    longest_episode: int = Field(
        default=500, ge=1, description="longest episode; of a longer one, the first steps are learned from"
    )
    policy_units: Annotated[tuple[Annotated[int, Field(ge=1)], ...], LEVELS.bound(len)] = Field(
        default=(64, 32), strict=False, description="number of tanh units of each hidden layer of the policy"
    )
    initial_deviation: float = Field(
        default=1.0, gt=0, description="initial standard deviation of actions, in half ranges; learned"
    )
    max_kl: float = Field(default=0.01, gt=0, description="bound of the KL divergence of successive policies")
    trace_decay: float = Field(default=1.0, ge=0, le=1, description="decay of advantage estimation (lambda)")
    damping: float = Field(default=1e-5, ge=0, description="damping of the policy's Fisher matrix")
    cg_steps: int = Field(default=10, ge=1, description="number of steps of the conjugate gradient method")
    backtracks: int = Field(default=15, ge=1, description="number of attempts of the line search")
    backtrack_ratio: float = Field(default=0.8, gt=0, lt=1, description="factor of the step per attempt")
    model_units: int = Field(default=32, ge=1, description="number of rectified units of the dynamics model")
    prior_deviation: float = Field(
        default=0.5, gt=0, description="prior and initial standard deviation of the model's weights"
    )
    likelihood_deviation: float = Field(
        default=5.0, gt=0, description="standard deviation of the model's likelihood (standardised outputs)"
    )
    num_samples: int = Field(default=10, ge=1, description="number of model draws in the likelihood")
    num_batches: float = Field(default=5.0, gt=0, description="divisor of the KL term in the model's loss")
    model_learning_rate: float = Field(
        default=1e-3, gt=0, description="learning rate of Adam for the model; 1e-4 in the published script"
    )
    model_updates: int = Field(default=500, ge=1, description="number of updates of the model per iteration")
    model_batch: int = Field(default=10, ge=1, description="number of transitions of an update of the model")
    pool_size: int = Field(default=100_000, ge=1, description="number of transitions to draw updates from")
    min_pool: float = Field(default=500, ge=0, description="transitions in the pool before the first update")
    gain_step: float = Field(default=0.01, gt=0, description="step size of the information gain (lambda)")
    max_bonus: float = Field(default=1000.0, gt=0, description="bound of the bonus before it is normalised")
    num_medians: int = Field(default=10, ge=1, description="number of medians that normalise the bonus")
    block: _Block = 16


class _QNetworks(LearnerSettings, frozen=True):
    """Settings of all learners with Q-networks."""

    actions_per_dimension: _ActionsPerDimension = 3
    learning_rate: float = Field(default=1e-3, gt=0, description="learning rate of Adam")
    target_rate: float = Field(
        default=0.01, gt=0, le=1, description="step of the slow copy of the networks per gradient step"
    )
    width: int = Field(default=64, ge=1, description="number of units of a hidden layer")
    depth: Annotated[int, LEVELS.bound()] = Field(default=2, ge=1, description="number of hidden layers")
    batch_size: int = Field(default=32, ge=1, description="number of transitions of a gradient step")
    train_every: int = Field(
        default=4, ge=1, description="number of steps between gradient steps, and between checks of the end"
    )


class BootstrappedQ(_QNetworks, frozen=True):
    """Q-networks with random priors; a random one acts for an episode (Osband et al., NeurIPS 2018)."""

    target: ClassVar[str] = "bojax.learning.bootstrapped_q:BootstrappedQ"
    kind: Literal["bootstrapped-q"] = "bootstrapped-q"
    prior_scale: float = Field(default=3.0, ge=0, description="factor of the prior networks; 0 for none")
    mask_probability: float = Field(
        default=0.5, gt=0, le=1, description="probability that a head learns from a transition"
    )
    num_heads: int = Field(default=10, ge=1, description="number of Q-networks (K)")


class RND(_QNetworks, frozen=True):
    """Q-networks explored by the error of predicting a random network (Burda et al., ICLR 2019)."""

    target: ClassVar[str] = "bojax.learning.rnd:RND"
    kind: Literal["rnd"] = "rnd"
    kappa: float = Field(default=1.0, ge=0, description="weight of U in the policy")
    epsilon: _Epsilon = 0.1
    u_discount: float = Field(default=0.99, ge=0, lt=1, description="discount of bonuses per step")
    num_outputs: int = Field(default=16, ge=1, description="number of outputs of the random network")


class ExplorationRewardSettings(Component, frozen=True):
    """An exploration reward."""

    role: ClassVar[str] = "exploration-reward"
    plural: ClassVar[str] = "exploration rewards"
    protocol: ClassVar[str] = "bojax.learning.exploration_rewards:ExplorationReward"


class FirstVisit(ExplorationRewardSettings, frozen=True):
    """0 for the first visit of a state-action pair, -1 for later visits (thesis, p. 118)."""

    target: ClassVar[str] = "bojax.learning.exploration_rewards:FirstVisit"
    kind: Literal["first-visit"] = "first-visit"


class NextUncertainty(ExplorationRewardSettings, frozen=True):
    """Mean uncertainty 1 / sqrt(1 + visits) of the next state's actions, minus 1 (thesis, equation 5.9)."""

    target: ClassVar[str] = "bojax.learning.exploration_rewards:NextUncertainty"
    kind: Literal["next-uncertainty"] = "next-uncertainty"


class _Tabular(LearnerSettings, frozen=True):
    """Settings of all tabular learners."""

    learning_rate: float = Field(default=0.1, ge=0, le=1, description="learning rate of the TD update")
    initial_q: float = Field(default=0.0, description="initial Q; optimistic if above all possible returns")
    ties: Literal["random", "first"] = Field(
        default="random", description="ties of the best actions: broken at random, or by the first"
    )
    block: _Block = 16


_RewardOfExploration = Annotated[
    Component, Slot("exploration-reward"), Field(description="exploration reward of a transition")
]


class ExplorationValues(_Tabular, frozen=True):
    """Q-learning with a second table U of exploration rewards; acts by argmax Q + kappa U (Algorithm 5)."""

    target: ClassVar[str] = "bojax.learning.tabular:ExplorationValues"
    kind: Literal["exploration-values"] = "exploration-values"
    kappa: float = Field(default=1.0, ge=0, description="weight of U in the policy")
    initial_u: float = Field(default=0.0, description="initial U; 0 is optimistic, as r_e is at most 0")
    exploration_reward: _RewardOfExploration = FirstVisit()
    bootstrap: Literal["greedy-q", "policy", "max"] = Field(
        default="greedy-q",
        description="values of the next state in the TD targets: the maximum of Q and U of argmax Q + kappa "
        "U, so that exploration can stop at any time; Q and U of argmax Q + kappa U (5.7), so that Q is the "
        "return of the exploring policy; or the maximum of each, which can get stuck",
    )
    terminal_u: Literal["masked", "bootstrap"] = Field(
        default="masked",
        description="U of a terminal state: 0, or the value in the table, which is never updated and stays "
        "initial_u; equal if initial_u is 0",
    )


class AdditiveRewards(_Tabular, frozen=True):
    """Q-learning of rewards plus xi times exploration rewards (thesis, equation 5.1)."""

    target: ClassVar[str] = "bojax.learning.tabular:AdditiveRewards"
    kind: Literal["additive"] = "additive"
    xi: float = Field(default=1.0, ge=0, description="weight of exploration rewards in the TD target")
    exploration_reward: _RewardOfExploration = FirstVisit()


class EpsilonGreedy(_Tabular, frozen=True):
    """Q-learning that takes a random action with probability epsilon."""

    target: ClassVar[str] = "bojax.learning.tabular:EpsilonGreedy"
    kind: Literal["epsilon-greedy"] = "epsilon-greedy"
    epsilon: _Epsilon = 0.1


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
    """Exploration scaled by 1 / (1 + c t), with t the number of episodes before (thesis, p. 121)."""

    target: ClassVar[str] = "bojax.learning.schedules:Decay"
    kind: Literal["decay"] = "decay"
    rate: float = Field(default=0.1, ge=0, description="decay rate c, per episode")


class Linear(ScheduleSettings, frozen=True):
    """Exploration scaled from 1 down to a final share, linearly over a number of episodes."""

    target: ClassVar[str] = "bojax.learning.schedules:Linear"
    kind: Literal["linear"] = "linear"
    episodes: int = Field(default=100, ge=1, description="number of episodes over which exploration falls")
    final: float = Field(default=0.0, ge=0, le=1, description="share of exploration after these episodes")


class Budget(ScheduleSettings, frozen=True):
    """Exploration for a number of episodes, then none; optionally it resumes later (thesis, p. 119)."""

    target: ClassVar[str] = "bojax.learning.schedules:Budget"
    kind: Literal["budget"] = "budget"
    episodes: int = Field(default=30, ge=0, description="number of episodes with exploration")
    resume_after: int | None = Field(
        default=None, ge=1, description="number of episodes before it resumes for good; null for never"
    )
    learns_without: bool = Field(default=False, description="whether it keeps learning without exploring")


class UntilTarget(ScheduleSettings, frozen=True):
    """Exploration until the test episodes reach their target return (thesis, p. 123)."""

    target: ClassVar[str] = "bojax.learning.schedules:UntilTarget"
    kind: Literal["until-target"] = "until-target"
    learns_after: bool = Field(default=False, description="whether it keeps learning after the target")


class Exploit(ScheduleSettings, frozen=True):
    """Neither exploration nor learning: the evaluation of a saved learner."""

    target: ClassVar[str] = "bojax.learning.schedules:Exploit"
    kind: Literal["exploit"] = "exploit"
