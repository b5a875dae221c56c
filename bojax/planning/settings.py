"""Settings of the planners."""

from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field

from bojax.acquisition.settings import UpperConfidenceBound
from bojax.config.component import RECORDED, Component, Slot
from bojax.config.limits import LEVELS
from bojax.fields.data import read_waypoints, record_sha256
from bojax.models.settings import RBF
from bojax.motions.settings import (
    ContinuousMotions,
    CubicCurves,
    DiscreteMotions,
    KernelTrajectories,
    Splines,
)
from bojax.problems.settings import Gradient, Uncertainty


class PlannerSettings(Component, frozen=True):
    """A planner."""

    role: ClassVar[str] = "planner"
    plural: ClassVar[str] = "planners"
    protocol: ClassVar[str] = "bojax.planning.base:Planner"


_Objective = Annotated[
    Component | None,
    Slot("objective", optional=True),
    Field(description="objective to maximise; null for the problem's task"),
]
_Family = Field(description="family of trajectories")
_Discrete = Annotated[Component, Slot("motions", only=DiscreteMotions), _Family]
_Continuous = Annotated[Component, Slot("motions", only=ContinuousMotions), _Family]
_Acquisition = Annotated[
    Component, Slot("acquisition"), Field(description="acquisition that new actions maximise")
]
_NumRolloutPaths = Annotated[
    int, Field(ge=1, description="number of random paths that rollouts draw from, new for each plan")
]


class _TreeSearch(PlannerSettings, frozen=True):
    iterations: int = Field(default=300, ge=1, description="simulations per plan")
    depth: Annotated[int, LEVELS.bound()] = Field(default=3, ge=1, description="actions up to the horizon")
    exploration: float = Field(
        default=300.0,
        ge=0,
        description="weight of the exploration bonus (kappa_MC of 4.1), in units of the return",
    )
    discount: float = Field(default=1.0, gt=0, le=1, description="discount per step")
    objective: _Objective = None


class _ContinuousBeliefTreeSearch(_TreeSearch, frozen=True):
    target: ClassVar[str] = "bojax.planning.cbts:ContinuousBeliefTreeSearch"

    max_actions: int = Field(default=20, ge=1, description="largest number of actions of a node (A_max)")
    kernel: Annotated[Component, Slot("kernel")] = Field(
        default=RBF(), description="kernel of a node's Gaussian process, from [-1, 1]^D to rewards"
    )
    acquisition: _Acquisition = UpperConfidenceBound(kappa=100.0)
    convergence: float = Field(
        default=0.0,
        ge=0,
        description="distance of successive actions that ends new actions at a node; 0: never",
    )
    scaling: Literal["standardise", "rank", "none"] = Field(
        default="standardise",
        description="scaling of a node's rewards for its Gaussian process: to mean 0 and variance 1, to "
        "their ranks spread evenly over [-1, 1], or none",
    )
    num_initial: int = Field(default=2, ge=1, description="number of first actions of a node that are random")
    noise_variance: float = Field(
        default=0.01, gt=0, description="noise variance of a node's Gaussian process, of scaled rewards"
    )
    num_candidates: int = Field(
        default=128, ge=1, description="number of quasi-random candidates of new actions, drawn for each plan"
    )
    refine_steps: int = Field(default=0, ge=0, description="number of gradient steps from the best candidate")
    measures_shortfall: bool = Field(
        default=False,
        description="whether runs.parquet has the column shortfall: how close the actions of the root before "
        "the last one come to the best candidate, which takes one more simulation for each candidate",
    )


class KCBTS(_ContinuousBeliefTreeSearch, frozen=True):
    """Continuous belief tree search on kernel trajectories (thesis, Algorithms 3-4, Section 4.6)."""

    kind: Literal["kcbts"] = "kcbts"
    motions: _Continuous = KernelTrajectories()


class CBTS(_ContinuousBeliefTreeSearch, frozen=True):
    """Continuous belief tree search on cubic curves (thesis, Algorithm 3)."""

    kind: Literal["cbts"] = "cbts"
    motions: _Continuous = CubicCurves()


class _DiscreteTreeSearch(_TreeSearch, frozen=True):
    target: ClassVar[str] = "bojax.planning.discrete:DiscreteTreeSearch"

    motions: _Discrete = Splines()


class SBO(_DiscreteTreeSearch, frozen=True):
    """Monte Carlo tree search over a discrete set of trajectories (thesis, Algorithm 2)."""

    kind: Literal["sbo"] = "sbo"


class BOPOMDP(_DiscreteTreeSearch, frozen=True):
    """Tree search over a discrete set that samples the steep areas of a field (thesis, Algorithm 2)."""

    kind: Literal["bo-pomdp"] = "bo-pomdp"
    objective: _Objective = Gradient()


class _MyopicPlanner(PlannerSettings, frozen=True):
    target: ClassVar[str] = "bojax.planning.myopic:MyopicPlanner"

    motions: _Discrete = Splines()
    objective: _Objective = None


class Myopic(_MyopicPlanner, frozen=True):
    """The best next trajectory of a discrete set, by exhaustive search (thesis, Section 3.3.1)."""

    kind: Literal["myopic"] = "myopic"


class Explorer(_MyopicPlanner, frozen=True):
    """The next trajectory of a discrete set with the largest uncertainty (thesis, Section 3.5.1)."""

    kind: Literal["explorer"] = "explorer"
    objective: _Objective = Uncertainty()


class GpsAbt(_TreeSearch, frozen=True):
    """Tree search whose nodes refine their actions by generalised pattern search (ABT toolkit)."""

    target: ClassVar[str] = "bojax.planning.gps_abt:PatternSearch"
    kind: Literal["gps-abt"] = "gps-abt"
    exploration: float = Field(
        default=100.0,
        ge=0,
        description="weight of the exploration bonus (root of the toolkit's C), as the return",
    )
    growth: float = Field(
        default=5.0, gt=1, description="growth k: a node of N visits has up to ln N / ln k levels of stencils"
    )
    min_visits: float = Field(
        default=2.0, ge=0, description="visits of every best point on the way before a stencil is refined"
    )
    min_radius: float = Field(default=0.1, gt=0, description="largest radius of stencils not refined")
    initial_radius: float = Field(default=1.0, gt=0, description="initial radius; the box is [-1, 1]")
    max_levels: int = Field(default=6, ge=1, description="largest number of stencils on a descent")
    num_rollout_paths: _NumRolloutPaths = 128
    heuristic: Literal["rollout", "zero"] = Field(
        default="rollout", description="value after a new action: of a random rollout to the horizon, or zero"
    )
    motions: _Continuous = KernelTrajectories()


class Random(PlannerSettings, frozen=True):
    """Trajectories drawn at random."""

    target: ClassVar[str] = "bojax.planning.random:RandomPlanner"
    kind: Literal["random"] = "random"
    motions: Annotated[Component, Slot("motions"), _Family] = Splines()


class BeliefPlannerSettings(PlannerSettings, frozen=True):
    """A planner on a belief of particles."""


class Widening(Component, frozen=True):
    """Progressive widening: at most k n^alpha children after n visits."""

    role: ClassVar[str] = "widening"
    plural: ClassVar[str] = "rules of widening"
    target: ClassVar[str] = "bojax.planning.widening:Widening"
    kind: Literal["power"] = "power"
    coefficient: float = Field(default=30.0, gt=0, description="factor k")
    exponent: float = Field(default=1 / 30, gt=0, le=1, description="exponent alpha")


class ProposalSettings(Component, frozen=True):
    """How a belief search proposes new actions."""

    role: ClassVar[str] = "proposal"
    plural: ClassVar[str] = "proposals of actions"
    protocol: ClassVar[str] = "bojax.planning.proposals:Proposal"


class RandomProposal(ProposalSettings, frozen=True):
    """A random action."""

    target: ClassVar[str] = "bojax.planning.proposals:RandomProposal"
    kind: Literal["random"] = "random"


class VoronoiProposal(ProposalSettings, frozen=True):
    """A random action, or one in the Voronoi cell of the best action so far (Lim et al., 2021)."""

    target: ClassVar[str] = "bojax.planning.proposals:VoronoiProposal"
    kind: Literal["voronoi"] = "voronoi"
    probability: float = Field(default=0.7, ge=0, le=1, description="probability of a random action")
    variance: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(strict=False)] = Field(
        default=(0.1,),
        min_length=1,
        description="variance about the best action, of each parameter in [-1, 1]; one number for all",
    )
    radius: float = Field(default=0.01, ge=0, description="distance within which a candidate is accepted")
    max_candidates: int = Field(default=20, ge=1, description="number of candidates")


class GaussianProcessProposal(ProposalSettings, frozen=True):
    """The maximum of an acquisition under a Gaussian process of the actions so far: CBTS on such beliefs."""

    target: ClassVar[str] = "bojax.planning.gp_proposal:GaussianProcessProposal"
    kind: Literal["gp"] = "gp"
    learns: Literal["reward", "return"] = Field(
        default="return",
        description="what the process learns of an action: the immediate reward (thesis) or the return",
    )
    kernel: Annotated[Component, Slot("kernel")] = Field(
        default=RBF(),
        description="kernel of actions, in coordinates of [-1, 1]; an angle is on a unit circle",
    )
    level_correlation: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="correlation of actions that differ only in a level, as in a look",
    )
    acquisition: _Acquisition = UpperConfidenceBound(kappa=2.0)
    noise_variance: float = Field(
        default=0.01, ge=0, description="variance of the noise added to means, which have variance 1"
    )
    num_initial: int = Field(default=2, ge=1, description="number of first actions that are random")
    num_candidates: int = Field(
        default=128, ge=1, description="number of random actions that the acquisition chooses from"
    )


class LeafValueSettings(Component, frozen=True):
    """The estimate of the value of a new belief."""

    role: ClassVar[str] = "leaf-value"
    plural: ClassVar[str] = "values of leaves"
    protocol: ClassVar[str] = "bojax.planning.leaf_values:LeafValue"


_Policy = Literal[
    "to-next-ml",
    "to-next-mean",
    "manage-uncertainty",
    "qmdp",
    "localise-first",
    "aside-first",
    "ping-first",
    "slow-down",
]


class Rollout(LeafValueSettings, frozen=True):
    """Mean return of simulations to the horizon."""

    target: ClassVar[str] = "bojax.planning.leaf_values:Rollout"
    kind: Literal["rollout"] = "rollout"
    policy: _Policy | None = Field(
        default=None, description="policy of the simulations; null for random actions"
    )
    num_rollouts: int = Field(default=1, ge=1, description="number of simulations")


_BeliefStep = Annotated[
    Literal["observed", "published"],
    Field(description="whether termination is observed, or treated as in the published program"),
]


class BeliefRollout(LeafValueSettings, frozen=True):
    """Return of one simulation of a policy that acts on sets of particles, to the horizon; for pft-dpw."""

    target: ClassVar[str] = "bojax.planning.pft:BeliefRollout"
    kind: Literal["belief-rollout"] = "belief-rollout"
    policy: _Policy = Field(default="qmdp", description="policy of the simulation")
    belief_step: _BeliefStep = "observed"


class StateValue(LeafValueSettings, frozen=True):
    """Mean value of the states, as if they were observed (MDP)."""

    target: ClassVar[str] = "bojax.planning.leaf_values:StateValue"
    kind: Literal["state-value"] = "state-value"


class Policy(BeliefPlannerSettings, frozen=True):
    """A policy without search: the least that a planner on the same problem has to beat."""

    target: ClassVar[str] = "bojax.planning.belief_planner:PolicyPlanner"
    kind: Literal["policy"] = "policy"
    policy: _Policy = Field(default="qmdp", description="policy, each made for some of the problems")


_ActionWidening = Annotated[Component, Slot("widening"), Field(description="number of actions of a belief")]
_ObservationWidening = Annotated[
    Component, Slot("widening"), Field(description="number of observations of an action")
]
_Proposal = Annotated[
    Component, Slot("proposal"), Field(description="new actions of a space that is not a list")
]


class _Widened(PlannerSettings, frozen=True):
    exploration: float = Field(default=110.0, ge=0, description="factor c of the exploration bonus")
    action_widening: _ActionWidening = Widening()
    observation_widening: _ObservationWidening = Widening(coefficient=5.0, exponent=0.01)
    proposal: _Proposal = RandomProposal()
    recommendation: Literal["value", "visits"] = Field(
        default="value", description="whether the plan has the highest value or most visits"
    )
    iterations: int = Field(default=1000, ge=1, description="simulations per plan")
    max_actions: int = Field(default=40, ge=1, description="capacity of a belief, unless actions are a list")
    max_branches: int = Field(default=16, ge=1, description="capacity of an action; 1: no branching")


class _BeliefSearch(_Widened, BeliefPlannerSettings, frozen=True):
    leaf_value: Annotated[Component, Slot("leaf-value")] = Field(
        default=Rollout(), description="value of a new belief"
    )
    first_action: _Policy | None = Field(
        default=None, description="policy that gives the first action of the root; null for none"
    )
    depth: int = Field(default=10, ge=1, description="actions up to the horizon")
    trees: int = Field(
        default=1, ge=1, description="independent trees of a plan, each with this number of simulations"
    )
    merge_lengthscale: float = Field(
        default=0.2,
        ge=1e-6,
        description="distance at which first actions of several trees are alike: parameters of actions are "
        "in [-1, 1], and an angle is a point on the unit circle",
    )


class PFTDPW(_BeliefSearch, frozen=True):
    """Tree search over sets of particles (Sunberg and Kochenderfer, ICAPS 2018, Algorithm 3)."""

    target: ClassVar[str] = "bojax.planning.pft:PFT"
    kind: Literal["pft-dpw"] = "pft-dpw"
    exploration: float = Field(default=70.0, ge=0, description="factor c of the exploration bonus")
    action_widening: _ActionWidening = Widening(coefficient=20.0, exponent=1 / 25)
    observation_widening: _ObservationWidening = Widening(coefficient=8.0, exponent=1 / 85)
    num_particles: int = Field(default=20, ge=1, description="particles of a belief of the tree")
    belief_step: _BeliefStep = "observed"
    information: float | None = Field(
        default=None, ge=0, description="reward of each nat of entropy taken from the belief; null for none"
    )


class _WeightedAsSimulated(_BeliefSearch, frozen=True):
    target: ClassVar[str] = "bojax.planning.pomcpow:POMCPOW"
    num_reservoirs: int = Field(default=16, ge=1, description="reservoirs of a branch, each with one step")


class POMCPOW(_WeightedAsSimulated, frozen=True):
    """Tree search with beliefs weighted as simulations pass (Sunberg and Kochenderfer, ICAPS 2018)."""

    kind: Literal["pomcpow"] = "pomcpow"


class VOMCPOW(_WeightedAsSimulated, frozen=True):
    """POMCPOW with Voronoi widening (Lim, Tomlin and Sunberg, 2021)."""

    kind: Literal["vomcpow"] = "vomcpow"
    exploration: float = Field(default=85.0, ge=0, description="factor c of the exploration bonus")
    observation_widening: _ObservationWidening = Widening(coefficient=2.5, exponent=0.01)
    proposal: _Proposal = VoronoiProposal()


class PathDPW(_Widened, frozen=True):
    """Tree search on paths with several imagined observations an action (after PFT-DPW, Algorithm 3)."""

    target: ClassVar[str] = "bojax.planning.path_dpw:PathDPW"
    kind: Literal["path-dpw"] = "path-dpw"
    motions: _Continuous = KernelTrajectories()
    exploration: float = Field(
        default=300.0, ge=0, description="factor c of the exploration bonus, in units of the return"
    )
    action_widening: _ActionWidening = Widening(coefficient=20.0, exponent=1 / 25)
    observation_widening: _ObservationWidening = Widening(coefficient=8.0, exponent=1 / 85)
    iterations: int = Field(default=300, ge=1, description="simulations per plan")
    depth: Annotated[int, LEVELS.bound()] = Field(default=3, ge=1, description="actions up to the horizon")
    discount: float = Field(default=1.0, gt=0, le=1, description="discount per step")
    objective: _Objective = None
    num_rollout_paths: _NumRolloutPaths = 128


class RouteSettings(PlannerSettings, frozen=True):
    """A route, driven piece by piece on a field."""

    length: float = Field(default=1.0, gt=0, description="length of the piece of a step, m")
    num_samples: int = Field(default=10, ge=2, description="poses of a piece")


class Route(RouteSettings, frozen=True):
    """A route from a file, as `bojax survey` writes it, driven piece by piece on a field."""

    target: ClassVar[str] = "bojax.planning.route:RouteFollower"
    kind: Literal["route"] = "route"
    file: str = Field(
        min_length=1,
        description="a .csv or .npy file of waypoints, relative to the working directory: columns x and y, m",
    )
    sha256: str | None = Field(default=None, description="SHA-256 of the file; null to compute it")

    @pydantic.model_validator(mode="after")
    def _readable(self, info: Any) -> "Route":
        if info.context is RECORDED and self.sha256 is not None:
            return self
        read_waypoints(self.file)
        record_sha256(self, self.file)
        return self
